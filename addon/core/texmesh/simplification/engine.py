"""Rounds of independent half-edge collapses of a textured mesh.

Vertices and wedges never move. In each round, vertices are taken from the beginning of an order, as far as they share no triangle. Each
collapses onto the first of its neighbors that the guards accept. A vertex that is refused is tried again when its neighborhood has changed.
"""

from typing import Protocol

import numpy as np

from ...geometry.collapses import select_independent
from ...geometry.mesh import vertex_normals
from ..textured_mesh import TexturedMesh
from .collapse_fans import CollapseFans, build_fans, find_compatible
from .collapse_guards import FOLD, SHORT_CURVE, VALID, Relaxation, Surface, find_orientations, find_refusals
from .islands import find_islands
from .manifold_copies import divide_into_surfaces
from .perceptual_values import PerceptualValues
from .topology import Collapses, Topology, build_topology

MAX_ATTEMPTS = 8  # neighbors that are tried per vertex and round
WINDOW_FRACTION, MIN_WINDOW = 0.2, 48  # of the vertices that may be removed: the first, from which a round chooses
WINDOW_EXCESS = 3.0  # at most so many times the vertices that are still to be removed
MIN_RETRY_FRACTION = 0.01  # of the refused vertices: collapses since their last attempt, from which on they are tried again
RANK_JITTER = 0.5  # of the window; without it, smooth orders would shrink row by row


class RemovalOrder(Protocol):
    """The order in which vertices are removed, and onto which neighbors."""

    def choose_window(self, engine: "CollapseEngine", vertices: np.ndarray, size: int) -> np.ndarray:
        """Return the first `size` of `vertices` (N,), in order."""

    def rate(self, collapses: Collapses) -> np.ndarray:
        """Return costs (N,) of `collapses`: cheaper ones are tried first, those with infinite costs never."""

    def select(self, vertices: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """Return which of `vertices` (N,) are removed in this round, (N,) bool, given the costs of their cheapest valid collapses."""

    def apply(self, collapses: Collapses, fans: CollapseFans) -> None:
        """Take note of `collapses` that are performed."""

    def mark_changed(self, vertices: np.ndarray) -> None:
        """Take note of `vertices` (N,) whose triangles have changed."""


class CollapseEngine:
    """The current triangles, (3, T), of a textured mesh, and the record of what was removed.

    mesh: with copies of vertices where several surfaces touch, is_locked (V,) bool; fine_vertices: (V,) int32, those that were given.
    groups: (W,) wedges between which there are no seams. reasons: (V,) uint8, why the preferred collapse of a vertex was refused.
    frees_ends: whether ends of seams may collapse. folded_count, dropped_island_count: collapses that only the `relaxation` allowed.
    """

    def __init__(self, mesh: TexturedMesh) -> None:
        mesh, self.fine_vertices, self.is_locked = divide_into_surfaces(mesh)
        self.mesh = mesh
        self.frees_ends = False
        self.triangles, self.wedges = (np.ascontiguousarray(array.T) for array in (mesh.triangles, mesh.wedge_triangles))
        self.materials = mesh.materials.copy()
        self.groups = np.arange(len(mesh.uvs), dtype=np.int32)
        self.orientations = find_orientations(mesh.corner_uvs, find_islands(mesh))
        vectors = (mesh.vertices, vertex_normals(mesh.vertices, mesh.triangles), mesh.uvs)
        self.surface = Surface(*(np.ascontiguousarray(values.T) for values in vectors))
        self.relaxation = Relaxation()
        self.perceptual = PerceptualValues(mesh.vertices)
        self.reasons = np.zeros(len(mesh.vertices), np.uint8)
        self.removed, self.kept, self.texels, self.values = [], [], [], []
        self.folded_count = self.dropped_island_count = 0
        self._retry_count = 0
        self._is_waiting = np.zeros(len(mesh.vertices), bool)
        self._random = np.random.default_rng(0)
        self.rebuild()

    @property
    def triangle_count(self) -> int:
        """The current number of triangles."""
        return self.triangles.shape[1]

    def rebuild(self) -> None:
        """Find the topology of the current triangles."""
        self.topology: Topology = build_topology(self.triangles, self.wedges, self.groups, self.is_locked, self.frees_ends)

    def retry(self, is_forced: bool = False) -> bool:
        """Let all refused vertices be tried again, unless hardly any collapses were performed since the last time. Return whether they are.

        is_forced: whether they are tried again in any case.
        """
        waiting_count = np.count_nonzero(self._is_waiting & self.topology.is_used)
        collapse_count = sum(map(len, self.removed))
        has_progress = collapse_count - self._retry_count >= max(MIN_RETRY_FRACTION * waiting_count, 1)
        if not waiting_count or not (is_forced or has_progress):
            return False
        self._retry_count = collapse_count
        self._is_waiting[:] = False
        return True

    def run_round(self, order: RemovalOrder, excess: int) -> int | None:
        """Perform collapses that remove up to `excess` triangles, or one more. Return how many, None if no vertex is left to be tried."""
        candidates = np.flatnonzero(self.topology.is_removable & ~self._is_waiting).astype(np.int32)
        if not len(candidates):
            return None
        size = min(max(int(WINDOW_FRACTION * len(candidates)), MIN_WINDOW), max(int(WINDOW_EXCESS * excess / 2.0), 4))
        vertices = self._choose_independent(order.choose_window(self, candidates, size))
        collapses = self._find_accepted(order, vertices)
        if not len(collapses.removed):
            return 0
        fans = self._build_fans(collapses)
        is_chosen = find_compatible(fans)
        vanishing = np.where(is_chosen, fans.vanishing_counts, 0)
        is_chosen &= np.cumsum(vanishing) - vanishing < excess
        collapses = collapses.take(np.flatnonzero(is_chosen))
        if not len(collapses.removed):
            return 0
        self._perform(self._build_fans(collapses), order)
        return len(collapses.removed)

    def replace(self, triangles: np.ndarray, wedges: np.ndarray, materials: np.ndarray, orientations: np.ndarray) -> None:
        """Replace the triangles (3, T), and let refused vertices be tried again."""
        self.triangles, self.wedges = np.ascontiguousarray(triangles), np.ascontiguousarray(wedges)
        self.materials, self.orientations = materials, orientations
        self._is_waiting[:] = False
        self.rebuild()

    def _choose_independent(self, window: np.ndarray) -> np.ndarray:
        """Return some vertices of `window` (N,) that share no triangle, in order."""
        jitter = RANK_JITTER * len(window) if len(window) > MIN_WINDOW else 0.0
        ranks = np.arange(len(window)) + self._random.uniform(0.0, jitter, len(window))
        positions = np.empty(len(self.reasons), np.int32)
        positions[window] = np.arange(len(window))
        chosen = select_independent(window, ranks, self.triangles, len(self.reasons))
        return window[np.sort(positions[chosen])]

    def _find_accepted(self, order: RemovalOrder, vertices: np.ndarray) -> Collapses:
        """Return the first collapse of each of `vertices` (N,) that is accepted, in the order of the vertices."""
        owners, collapses = self.topology.find_collapses(vertices, self.groups)
        costs = order.rate(collapses)
        by_cost = np.lexsort((costs, owners))
        by_cost = by_cost[np.isfinite(costs[by_cost])]
        first = np.searchsorted(owners[by_cost], np.arange(len(vertices) + 1))
        open_vertices = np.arange(len(vertices))
        accepted = np.full(len(vertices), -1)
        for attempt in range(MAX_ATTEMPTS):
            open_vertices = open_vertices[first[open_vertices] + attempt < first[open_vertices + 1]]
            if not len(open_vertices):
                break
            rows = by_cost[first[open_vertices] + attempt]
            reasons = find_refusals(self._build_fans(collapses.take(rows)), self.surface, self.orientations, self.relaxation)
            if attempt == 0:  # the reason that counts is that of the preferred collapse
                self.reasons[vertices[open_vertices]] = reasons
            accepted[open_vertices[reasons == VALID]] = rows[reasons == VALID]
            open_vertices = open_vertices[reasons != VALID]
        self._is_waiting[vertices[accepted < 0]] = True
        accepted = accepted[accepted >= 0]
        return collapses.take(accepted[order.select(collapses.removed[accepted], costs[accepted])])

    def _build_fans(self, collapses: Collapses) -> CollapseFans:
        return build_fans(self.topology, collapses, self.groups, self.mesh.attributes)

    def _perform(self, fans: CollapseFans, order: RemovalOrder) -> None:
        collapses = fans.collapses
        if self.relaxation != Relaxation():
            strict_reasons = find_refusals(fans, self.surface, self.orientations, Relaxation())
            self.folded_count += np.count_nonzero(strict_reasons == FOLD)
            self.dropped_island_count += np.count_nonzero(strict_reasons == SHORT_CURVE)
        order.apply(collapses, fans)
        self.values.append(self.perceptual.record(self.topology, collapses.removed, collapses.kept))
        self.removed.append(collapses.removed)
        self.kept.append(collapses.kept)
        self.texels.append(collapses.removed_wedges[0])
        changed = np.unique(fans.neighbors[1])
        self.triangles.reshape(-1)[fans.corners] = collapses.kept[fans.owners]
        self.wedges.reshape(-1)[fans.corners] = fans.wedges
        is_kept = np.ones(self.triangle_count, bool)
        is_kept[fans.triangles[fans.vanishes]] = False
        self.triangles, self.wedges = (np.compress(is_kept, array, axis=1) for array in (self.triangles, self.wedges))
        self.materials, self.orientations = self.materials[is_kept], self.orientations[is_kept]
        self._is_waiting[changed] = False
        order.mark_changed(changed)
        self.rebuild()
