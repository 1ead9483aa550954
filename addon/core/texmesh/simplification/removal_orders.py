"""Orders of removal: by given priorities, or by the cost of the cheapest collapse."""

from dataclasses import replace
from typing import Protocol

import numpy as np

from .collapse_fans import CollapseFans
from .engine import CollapseEngine
from .topology import Collapses

TIED_FRACTION = 0.01  # of priorities that are equal to others, above which ties are broken by perceptual values


class CollapseCost(Protocol):
    """A cost of half-edge collapses that changes as collapses are performed. Vertices and wedges are those of the fine mesh."""

    def evaluate(self, collapses: Collapses) -> np.ndarray:
        """Return the costs (N,) float64 of `collapses`, infinite for those that must not happen."""

    def merge(self, collapses: Collapses, fans: CollapseFans) -> None:
        """Take note of `collapses` that are performed."""


class GivenOrder:
    """Vertices with low priorities are removed first, and collapse onto the nearest neighbor. Ties are broken by perceptual values."""

    def __init__(self, positions: np.ndarray, priorities: np.ndarray, protected_fraction: float) -> None:
        """positions: (3, V). priorities: (V,) float64. protected_fraction: see `SimplificationSettings.protected_fraction`."""
        self._positions, self._priorities, self._protected_fraction = positions, priorities, protected_fraction
        has_ties = len(np.unique(priorities)) < (1.0 - TIED_FRACTION) * len(priorities)
        self._needs_values = has_ties or protected_fraction > 0.0
        self._values = np.zeros(len(priorities))
        self._is_stale = np.full(len(priorities), self._needs_values)

    def choose_window(self, engine: CollapseEngine, vertices: np.ndarray, size: int) -> np.ndarray:
        """See `RemovalOrder`."""
        stale = vertices[self._is_stale[vertices]]
        if len(stale):
            self._values[stale] = engine.perceptual.estimate(engine.topology, stale)
            self._is_stale[stale] = False
        values = self._values[vertices]
        index = int((1.0 - self._protected_fraction) * (len(vertices) - 1))
        if index < len(vertices) - 1:
            is_allowed = values <= np.partition(values, index)[index]
            vertices, values = vertices[is_allowed], values[is_allowed]
        return vertices[np.lexsort((values, self._priorities[vertices]))[:size]]

    def rate(self, collapses: Collapses) -> np.ndarray:
        """Return the squared distances (N,) to the kept vertices."""
        return ((self._positions[:, collapses.removed] - self._positions[:, collapses.kept]) ** 2).sum(axis=0)

    def select(self, vertices: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """See `RemovalOrder`."""
        return np.ones(len(costs), bool)

    def apply(self, collapses: Collapses, fans: CollapseFans) -> None:
        """See `RemovalOrder`."""

    def mark_changed(self, vertices: np.ndarray) -> None:
        """See `RemovalOrder`."""
        self._is_stale[vertices] = self._needs_values


class CheapestOrder:
    """Vertices with the cheapest collapses are removed first. Costs are evaluated again only for vertices that may be among them."""

    def __init__(self, cost: CollapseCost, fine_vertices: np.ndarray) -> None:
        """fine_vertices: (V,) int32, the indices by which `cost` knows the vertices of the engine."""
        self._cost, self._fine_vertices = cost, fine_vertices
        self._costs = np.zeros(len(fine_vertices))
        self._is_stale = np.ones(len(fine_vertices), bool)
        self._cutoff = np.inf

    def choose_window(self, engine: CollapseEngine, vertices: np.ndarray, size: int) -> np.ndarray:
        """See `RemovalOrder`."""
        size = min(size, len(vertices))
        window = vertices[np.argpartition(self._costs[vertices], size - 1)[:size]] if not self._is_stale.all() else vertices
        stale = window[self._is_stale[window]]
        owners, collapses = engine.topology.find_collapses(stale, engine.groups)
        costs = np.full(len(stale), np.inf)
        np.minimum.at(costs, owners, self.rate(collapses))
        self._costs[stale] = costs
        self._is_stale[stale] = False
        window = window[np.argsort(self._costs[window], kind="stable")]
        self._cutoff = np.partition(self._costs[vertices], size - 1)[size - 1]
        cheap = window[self._costs[window] <= self._cutoff]
        return cheap[:size]

    def rate(self, collapses: Collapses) -> np.ndarray:
        """Return the costs (N,)."""
        return self._cost.evaluate(self._to_fine(collapses))

    def select(self, vertices: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """See `RemovalOrder`."""
        self._costs[vertices] = costs
        return costs <= self._cutoff

    def apply(self, collapses: Collapses, fans: CollapseFans) -> None:
        """See `RemovalOrder`."""
        self._cost.merge(self._to_fine(collapses), fans)

    def mark_changed(self, vertices: np.ndarray) -> None:
        """See `RemovalOrder`."""
        self._is_stale[vertices] = True

    def _to_fine(self, collapses: Collapses) -> Collapses:
        return replace(collapses, removed=self._fine_vertices[collapses.removed], kept=self._fine_vertices[collapses.kept])
