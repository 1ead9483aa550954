"""Quadrics of position and texture coordinates, one per wedge, that are evaluated at the wedge that is kept."""

import numpy as np

from ...jobs.chunks import slices
from .collapse_fans import CollapseFans
from .topology import Collapses

ROWS, COLUMNS = np.triu_indices(6)
CHUNK_COLLAPSES = 1 << 13


class WedgeQuadrics:
    """The part that costs of collapses have in common. A subclass adds quadrics (W, 21) and areas (W,) of wedges, then calls `finish`."""

    def __init__(self, points: np.ndarray) -> None:
        """points: (W, 5), positions and texture coordinates of wedges, scaled alike."""
        homogeneous = np.column_stack([points, np.ones(len(points))])
        self._monomials = homogeneous[:, ROWS] * homogeneous[:, COLUMNS] * np.where(ROWS == COLUMNS, 1.0, 2.0)
        self._quadrics = np.zeros((len(points), len(ROWS)))
        self._areas = np.zeros(len(points))

    def finish(self) -> None:
        """Compute the costs of wedges that stay where they are."""
        self._own_costs = np.einsum("wk,wk->w", self._quadrics, self._monomials)

    def merge(self, collapses: Collapses, fans: CollapseFans) -> None:
        """See `CollapseCost`."""
        pairs = np.unique(fans.topology.wedges[fans.corners].astype(np.int64) * len(self._areas) + fans.wedges)
        self.merge_wedges(pairs // len(self._areas), pairs % len(self._areas))

    def merge_wedges(self, removed: np.ndarray, kept: np.ndarray) -> None:
        """Add the quadrics of wedges (N,) to those that take their place."""
        np.add.at(self._quadrics, kept, self._quadrics[removed])
        np.add.at(self._areas, kept, self._areas[removed])
        self._own_costs[kept] = np.einsum("wk,wk->w", self._quadrics[kept], self._monomials[kept])

    def evaluate_wedges(self, collapses: Collapses) -> np.ndarray:
        """Return the costs (N,) of moving the wedges of `collapses` on both sides onto others, not negative."""
        (removed, other_removed), (kept, other_kept) = collapses.removed_wedges, collapses.kept_wedges
        costs = self._evaluate(removed, kept)
        rows = np.flatnonzero((other_removed >= 0) & (other_removed != removed))
        costs[rows] += self._evaluate(other_removed[rows], other_kept[rows])
        return costs

    def _evaluate(self, removed: np.ndarray, kept: np.ndarray) -> np.ndarray:
        costs = np.empty(len(removed))
        for chunk in slices(len(removed), CHUNK_COLLAPSES):  # in parts that stay in the cache
            quadrics, monomials = self._quadrics.take(removed[chunk], axis=0), self._monomials.take(kept[chunk], axis=0)
            np.einsum("wk,wk->w", quadrics, monomials, out=costs[chunk])
        return np.maximum(costs + self._own_costs.take(kept), 0.0)
