"""Simplification of height fields by rounds of independent half-edge collapses, for thousands of separate domains at once.

Every vertex that remains is a sample of the field. In each round, the cheapest vertices of every domain that share no triangle collapse.
The cost of a collapse is the largest vertical distance to the new triangles from the vertex and from all samples removed before it in its
star. Only the distance of the vertex is known beforehand; the samples are located when a vertex is chosen, which then collapses or is more
expensive from now on. After Cignoni et al., BDAM, 2003, section 5.2, with vertical distances in place of quadrics.

The result for a domain does not depend on the other domains.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import gather, gather_columns
from ...geometry.collapses import find_cutoffs, order_by_cost, select_cheapest, select_independent
from ...geometry.vertex_rings import VertexRings, build_rings, to_triangles
from .collapse_costs import LOCKED, GridPoints, find_targets
from .collapsed_fans import RemovedSamples, arrange_fans

MAX_ROUNDS = 40
MAX_EXACT_DIFFERENCE = 1 << 11  # Products of differences up to this are exact in float32.
STALE_COST_RATIO = 1.2  # A changed vertex is evaluated again only if its last cost was below this many times the cutoff.
CANDIDATE_RATIO = 1.3  # The cutoff admits this many times the vertices to be removed; more need fewer rounds, but cost quality.
TOLERATED_EXCESS = 0.02  # Another round runs if more than this fraction of the vertices to be removed is left.


@dataclass(frozen=True)
class MeshBatch:
    """Separate meshes, the domains, which are simplified at once.

    Attributes:
        x, y: (V + S,) int32, grid coordinates of the vertices and of samples whose distances count.
        z: (V + S,) float32, heights in steps.
        lines: (V,) int8, constraints of `collapse_costs`.
        domains: (V,) int32, 0 to D - 1, ascending.
        triangles: (T, 3) int32, counterclockwise.
        sample_triangles: (S,) int32, triangles that contain the samples.
        extent: the largest difference of coordinates in any domain.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    lines: np.ndarray
    domains: np.ndarray
    triangles: np.ndarray
    sample_triangles: np.ndarray
    extent: int


def simplify(
    batch: MeshBatch, excess: np.ndarray, limits: np.ndarray, first: tuple[np.ndarray, np.ndarray] | None = None
) -> tuple[np.ndarray, RemovedSamples]:
    """Return the triangles (N, 3) int32 of the simplified meshes, with the vertices of the input, and the samples that they approximate.

    Args:
        excess: (D,) int, how many vertices to remove from each domain. Fewer are removed where locked vertices prevent it. limits: (D,)
            float32, the largest costs of collapses. first: vertices (N,) intp that share no triangle, and their targets (N,) intp, to
            collapse at the start.
    """
    state = _Decimation(batch, excess, limits)
    if first is not None:
        vertices, targets = first
        state.collapse(vertices, targets, build_rings(state.triangles, len(batch.lines)), is_checked=False)
    idle_rounds = 0
    for _ in range(MAX_ROUNDS):
        if idle_rounds == 2 or not state.is_unfinished.any():  # the second idle round shows that new cutoffs change nothing
            break
        idle_rounds = 0 if state.run_round() else idle_rounds + 1
    return np.ascontiguousarray(state.triangles.T.astype(np.int32)), state.samples


class _Decimation:
    """The current meshes, and costs of vertices. Those of vertices whose stars have changed are estimates until they are needed."""

    def __init__(self, batch: MeshBatch, excess: np.ndarray, limits: np.ndarray) -> None:
        self.lines, self.domains = batch.lines, batch.domains.astype(np.intp)
        self.triangles = np.ascontiguousarray(batch.triangles.T.astype(np.intp))
        count = len(batch.lines)
        starts = np.searchsorted(batch.domains, np.arange(len(excess)))
        self.points = _to_points(batch, starts)
        self.samples = RemovedSamples(np.arange(count, len(batch.x)), batch.sample_triangles.astype(np.intp))
        self._excess, self._tolerated = excess, TOLERATED_EXCESS * excess
        self._is_estimate = batch.lines != LOCKED
        self._costs, self._targets = np.where(self._is_estimate, 0.0, np.inf).astype(np.float32), np.zeros(count, np.intp)
        self._limits, self._cutoffs = limits, limits.copy()
        self._numbers = (np.arange(count) - starts[batch.domains]).astype(np.uint32)  # within the domain

    @property
    def is_unfinished(self) -> np.ndarray:
        """Whether vertices of a domain have to be removed, (D,) bool."""
        return self._excess > self._tolerated

    def run_round(self) -> bool:
        """Collapse independent vertices of all unfinished domains. Return whether there was anything to do."""
        rings = build_rings(self.triangles, len(self.lines))
        limits = np.where(self.is_unfinished, STALE_COST_RATIO * self._cutoffs, -1.0).astype(np.float32)
        stale = np.flatnonzero(self._is_estimate & (self._costs <= gather(limits, self.domains)))
        self._targets[stale], self._costs[stale] = find_targets(self.points, rings, self.lines, stale)
        self._is_estimate[stale] = False
        is_cheap = (self._costs <= gather(self._cutoffs, self.domains)) & (self._costs < np.inf)
        cheap = np.flatnonzero(is_cheap & ~self._is_estimate)
        keys = order_by_cost(gather(self._costs, cheap), gather(self._numbers, cheap))
        chosen = select_independent(cheap, keys, self.triangles, len(self.lines))
        chosen = select_cheapest(chosen, gather(self._costs, chosen), gather(self.domains, chosen), self._excess)
        if len(chosen):
            self.collapse(chosen, gather(self._targets, chosen), rings)
        return len(stale) > 0 or len(chosen) > 0

    def collapse(self, vertices: np.ndarray, targets: np.ndarray, rings: VertexRings, is_checked: bool = True) -> None:
        """Collapse `vertices` (N,) intp, which share no triangle, onto `targets` (N,) intp.

        With `is_checked`, vertices are left out if samples make them more expensive than the cutoffs, which rise with these costs.
        """
        triangle_count = self.triangles.shape[1]
        fans = arrange_fans(self.points, rings, vertices, targets)
        located = self.samples.locate(self.points, fans, triangle_count)
        is_accepted = np.ones(len(vertices), bool)
        if is_checked:
            costs = gather(self._costs, vertices)
            np.maximum.at(costs, located.owners, located.distances)
            self._costs[vertices] = costs
            self._update_cutoffs()
            is_accepted = costs <= gather(self._cutoffs, gather(self.domains, vertices))
        accepted = np.flatnonzero(is_accepted)
        removed = gather(vertices, accepted)
        self.samples.move(located, is_accepted)
        self.samples.add(removed, to_triangles(fans.locate(self.points, accepted, removed)[0], triangle_count))
        self._excess = self._excess - np.bincount(gather(self.domains, removed), minlength=len(self._excess))
        is_replaced = gather(is_accepted, fans.owners)
        star = fans.star.compress(is_replaced)
        self._mark_changes(removed, star, rings)
        self._replace_stars(star, fans.targets, fans.owners.compress(is_replaced), fans.is_kept.compress(is_replaced))

    def _update_cutoffs(self) -> None:
        """Find the costs up to which vertices of unfinished domains collapse, from as many vertices as are to be removed and some more."""
        is_unfinished = self.is_unfinished
        used = np.flatnonzero((self._costs < np.inf) & is_unfinished.take(self.domains))
        cutoffs = find_cutoffs(self._costs.take(used), self.domains.take(used), (CANDIDATE_RATIO * self._excess).astype(np.int64))
        self._cutoffs = np.where(is_unfinished, np.minimum(cutoffs, self._limits), np.float32(-1.0))

    def _mark_changes(self, removed: np.ndarray, star: np.ndarray, rings: VertexRings) -> None:
        """Mark the costs around the vertices `removed` (N,), the corners of whose stars are `star` (C,), as estimates."""
        is_changed = np.zeros(len(self.lines), bool)
        is_changed[gather(rings.next, star)] = True
        is_changed[gather(rings.previous, star)] = True
        is_changed &= self.lines != LOCKED
        self._is_estimate |= is_changed
        self._costs[is_changed & (self._costs == np.inf)] = 0.0  # a target may have become valid
        self._costs[removed] = np.inf
        self._is_estimate[removed] = False

    def _replace_stars(self, star: np.ndarray, targets: np.ndarray, owners: np.ndarray, keeps: np.ndarray) -> None:
        """Move the corners `star` (C,) of the vertices `owners` (C,) to their targets, and remove the triangles that do not remain, `keeps`
        (C,)."""
        count = self.triangles.shape[1]
        self.triangles.reshape(-1)[star] = gather(targets, owners)
        is_kept = np.ones(count, bool)
        is_kept[to_triangles(star.compress(~keeps), count)] = False
        self.triangles = gather_columns(self.triangles, np.flatnonzero(is_kept))
        self.samples.triangles = gather(np.cumsum(is_kept, dtype=np.intp) - 1, self.samples.triangles)


def _to_points(batch: MeshBatch, starts: np.ndarray) -> GridPoints:
    """Return coordinates relative to the first vertex of each domain, at `starts` (D,)."""
    real = np.float32 if batch.extent <= MAX_EXACT_DIFFERENCE else np.float64
    domains = np.concatenate([batch.domains, batch.domains[batch.triangles[batch.sample_triangles, 0]]])
    starts = np.minimum(starts, len(batch.x) - 1)
    return GridPoints(*((axis - axis[starts][domains]).astype(real) for axis in (batch.x, batch.y)), batch.z)
