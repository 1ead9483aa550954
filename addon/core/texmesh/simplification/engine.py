"""Rounds of independent half-edge collapses of a textured mesh.

In each round, vertices are taken from the beginning of an order, as far as they share no triangle. Each
collapses onto the first of its neighbors that the guards accept. A vertex that is refused is tried again when its neighborhood has changed.
For each collapse it is recorded how much it is seen (section IV.B of the paper). Kept vertices stay where they are, or move to where they
cost least.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ...arrays import concatenate_ranges
from ...geometry.collapses import select_independent
from ...geometry.mesh import vertex_normals
from ..textured_mesh import TexturedMesh
from .collapse_fans import (
    FOLD,
    SHORT_CURVE,
    VALID,
    CollapseFans,
    Relaxation,
    Surface,
    build_fans,
    find_compatible,
    find_orientations,
    find_refusals,
    replace_wedges,
)
from .perceptual_values import PerceptualValues
from .placement import VertexPlacement, shorten_steps
from .topology import Collapses, Topology, build_topology, divide_into_surfaces, find_islands

MAX_ATTEMPTS = 8  # neighbors that are tried per vertex and round
WINDOW_FRACTION, MIN_WINDOW = 0.2, 48  # A round chooses from the first vertices that may be removed: this fraction, or this number.
WINDOW_EXCESS = 3.0  # at most so many times the vertices that are still to be removed
MIN_RETRY_FRACTION = 0.01  # Refused vertices are tried again after collapses of this fraction of their number.
RANK_JITTER = 0.5  # Ranks vary by this fraction of the window; otherwise smooth orders would shrink row by row.


@dataclass(frozen=True)
class Copies:
    """Vertices and wedges that are appended to those of a `CollapseEngine`.

    Attributes:
        vertices: (N,) int32, those that the new ones are copies of.
        wedges: (M,) int32, likewise.
        homes: (M,) int32, the vertices of the new wedges.
        is_blank: whether the new wedges stand for no part of the fine surface, and only have the texture coordinates and attributes of
            those that they are copies of.
    """

    vertices: np.ndarray
    wedges: np.ndarray
    homes: np.ndarray
    is_blank: bool


class RemovalOrder(Protocol):
    """The order in which vertices are removed, and onto which neighbors. min_cost: of the collapses that were found last; 0 if they have
    none."""

    min_cost: float

    def choose_window(self, engine: "CollapseEngine", vertices: np.ndarray, size: int) -> np.ndarray:
        """Return the first `size` of `vertices` (N,), in order."""

    def rate(self, engine: "CollapseEngine", collapses: Collapses) -> np.ndarray:
        """Return costs (N,) of `collapses`: cheaper ones are tried first, those with infinite costs never."""

    def select(self, vertices: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """Return which of `vertices` (N,) are removed in this round, (N,) bool, given the costs of their cheapest valid collapses."""

    def apply(self, engine: "CollapseEngine", collapses: Collapses) -> None:
        """Take note of `collapses` that are performed next."""

    def drop_wedges(self, wedges: np.ndarray, vertices: np.ndarray) -> None:
        """Take note that `wedges` (N,), last at `vertices` (N,), have no triangles any more, and that no other wedges replace them."""

    def mark_changed(self, vertices: np.ndarray) -> None:
        """Take note of `vertices` (N,) whose triangles have changed."""

    def append(self, copies: Copies) -> None:
        """Take note of vertices and wedges that are appended."""


@dataclass(frozen=True)
class WedgeMoves:
    """What collapses do to the wedges of the vertices that they remove.

    Attributes:
        owners: (M,) int32, into the collapses, ascending.
        removed: (M,) wedges of the removed vertices.
        kept: (M,) wedges of the kept vertices that replace them, or the removed ones, which then move to the kept vertices.
        lost_islands: (2, N) UV islands whose last triangles vanish with those at each side of the edge; -1 for none.
    """

    owners: np.ndarray
    removed: np.ndarray
    kept: np.ndarray
    lost_islands: np.ndarray


class CollapseEngine:
    """The current triangles, (3, T), of a textured mesh, and the record of what was removed.

    Attributes:
        mesh: with copies of vertices and wedges where several surfaces touch.
        is_locked: (V,) bool, vertices where surfaces touch that stay.
        islands: (T,) int32, UV islands of `mesh`.
        is_reversed: (T,) bool, triangles that have the opposite orientation in the mesh that was given.
        fine_vertices, fine_wedges: (V,), (W,) int32, those that were given.
        groups: (W,) wedges between which there are no seams.
        reasons: (V,) uint8, why the preferred collapse of a vertex was refused.
        frees_ends: whether ends of seams may collapse.
        crosses_seams: see `Topology`.
        placement: where kept vertices move, None if they stay. Vertices where surfaces touch stay in any case.
        folded_count, dropped_island_count: collapses that only the `relaxation` allowed.
    """

    def __init__(self, mesh: TexturedMesh, crosses_seams: bool = False) -> None:
        """crosses_seams: whether the shape of seams, and touching surfaces, do not limit collapses; their costs count."""
        divided = divide_into_surfaces(mesh)
        self.mesh = mesh = divided.mesh
        self.fine_vertices, self.fine_wedges = divided.fine_vertices, divided.fine_wedges
        self.crosses_seams, self.frees_ends = crosses_seams, False
        self.is_locked = np.zeros_like(divided.is_touching) if crosses_seams else divided.is_touching
        self.triangles, self.wedges = (np.ascontiguousarray(array.T) for array in (mesh.triangles, mesh.wedge_triangles))
        self.materials, self.is_reversed = mesh.materials.copy(), divided.is_reversed
        self.groups = np.arange(len(mesh.uvs), dtype=np.int32)
        self.islands = find_islands(mesh)
        self.orientations = find_orientations(mesh.corner_uvs, self.islands)
        vectors = (mesh.vertices, vertex_normals(mesh.vertices, mesh.triangles), mesh.uvs)
        self.surface = Surface(*(np.ascontiguousarray(values.T) for values in vectors))
        self.relaxation = Relaxation()
        self.placement: VertexPlacement | None = None
        self.perceptual = PerceptualValues(mesh.vertices)
        self.reasons = np.zeros(len(mesh.vertices), np.uint8)
        self.removed, self.kept, self.values = [], [], []
        self.folded_count = self.dropped_island_count = 0
        self._retry_count = 0
        self._is_waiting = np.zeros(len(mesh.vertices), bool)
        self._is_divided = _find_divided(self.fine_vertices)
        self._random = np.random.default_rng(0)
        self.rebuild()

    @property
    def triangle_count(self) -> int:
        """The current number of triangles."""
        return self.triangles.shape[1]

    def rebuild(self) -> None:
        """Find the topology of the current triangles."""
        self.topology: Topology = build_topology(
            self.triangles, self.wedges, self.groups, self.is_locked, self.frees_ends, self.crosses_seams
        )
        self._island_counts = np.bincount(self.islands, minlength=1)

    def find_moves(self, collapses: Collapses) -> WedgeMoves:
        """Return what `collapses` do to wedges."""
        starts, wedges = self.topology.vertex_wedges
        counts = starts[collapses.removed + 1] - starts[collapses.removed]
        owners = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
        removed = wedges[concatenate_ranges(starts[collapses.removed], counts)]
        kept = replace_wedges(collapses, owners, removed, self.groups, self.mesh.attributes)
        return WedgeMoves(owners, removed, kept, self._find_lost_islands(collapses.halfedges))

    def _find_lost_islands(self, halfedges: np.ndarray) -> np.ndarray:
        """Return the islands (2, N) whose last triangles are those at `halfedges` (N,), see `WedgeMoves`."""
        twins = self.topology.twins[halfedges]
        first = self.islands[halfedges % self.triangle_count]
        second = np.where(twins >= 0, self.islands[twins % self.triangle_count], np.int32(-1))
        counts = self._island_counts
        is_first = counts[first] == 1 + (first == second)
        is_second = (second >= 0) & (second != first) & (counts[np.maximum(second, 0)] == 1)
        return np.stack([np.where(is_first, first, -1), np.where(is_second, second, -1)])

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

    def keep_triangles(self, is_kept: np.ndarray) -> None:
        """Drop all triangles but those that `is_kept` (T,) bool names, and let refused vertices be tried again."""
        self._keep(is_kept)
        self._is_waiting[:] = False
        self.rebuild()

    def _keep(self, is_kept: np.ndarray) -> None:
        self.triangles, self.wedges = (np.compress(is_kept, array, axis=1) for array in (self.triangles, self.wedges))
        columns = (self.materials, self.islands, self.orientations, self.is_reversed)
        self.materials, self.islands, self.orientations, self.is_reversed = (values[is_kept] for values in columns)

    def add_triangles(self, vertices: np.ndarray, wedges: np.ndarray, neighbors: np.ndarray) -> None:
        """Add triangles of `vertices` and `wedges` (3, N) like their `neighbors` (N,), and let refused vertices be tried again."""
        self.triangles, self.wedges = np.concatenate([self.triangles, vertices], axis=1), np.concatenate([self.wedges, wedges], axis=1)
        columns = (self.materials, self.islands, self.orientations, self.is_reversed)
        self.materials, self.islands, self.orientations, self.is_reversed = (
            np.concatenate([values, values[neighbors]]) for values in columns
        )
        self._is_waiting[:] = False
        self.rebuild()

    def divide(self, corners: np.ndarray, order: RemovalOrder) -> None:
        """Divide the surface: give `corners` (N,), halfedges that begin there, vertices and wedges of their own, at the same place."""
        vertices, own_vertices = np.unique(self.topology.starts[corners], return_inverse=True)
        wedges, first, own_wedges = np.unique(self.topology.wedges[corners], return_index=True, return_inverse=True)
        own_vertices, own_wedges = own_vertices + len(self.reasons), own_wedges + len(self.groups)
        self._append(Copies(vertices, wedges, own_vertices[first].astype(np.int32), is_blank=False), order)
        self.triangles.reshape(-1)[corners], self.wedges.reshape(-1)[corners] = own_vertices, own_wedges
        self.rebuild()
        order.mark_changed(np.unique(self.triangles[:, corners % self.triangle_count]))

    def add_wedges(self, wedges: np.ndarray, vertices: np.ndarray, order: RemovalOrder) -> np.ndarray:
        """Return new wedges at `vertices`, with the texture coordinates and attributes of `wedges`, all of the same shape, int32."""
        first = len(self.groups)
        self._append(Copies(np.zeros(0, np.int32), wedges.reshape(-1), vertices.reshape(-1), is_blank=True), order)
        return np.arange(first, len(self.groups), dtype=np.int32).reshape(wedges.shape)

    def _append(self, copies: Copies, order: RemovalOrder) -> None:
        vertices, wedges = copies.vertices, copies.wedges
        groups = np.arange(len(wedges)) if copies.is_blank else np.unique(self.groups[wedges], return_inverse=True)[1]
        self.groups = np.concatenate([self.groups, self.groups.max(initial=-1) + 1 + groups]).astype(self.groups.dtype)
        mesh, surface = self.mesh, self.surface
        self.mesh = replace(
            mesh,
            vertices=np.concatenate([mesh.vertices, mesh.vertices[vertices]]),
            wedge_vertices=np.concatenate([mesh.wedge_vertices, copies.homes]),
            uvs=np.concatenate([mesh.uvs, mesh.uvs[wedges]]),
            attributes=np.concatenate([mesh.attributes, mesh.attributes[wedges]]),
        )
        columns = ((surface.positions, vertices), (surface.normals, vertices), (surface.uvs, wedges))
        self.surface = Surface(*(np.concatenate([values, values[:, rows]], axis=1) for values, rows in columns))
        self.fine_wedges = np.concatenate([self.fine_wedges, self.fine_wedges[wedges]])
        per_vertex = (self.fine_vertices, self.is_locked, self.reasons, self._is_waiting)
        self.fine_vertices, self.is_locked, self.reasons, self._is_waiting = (
            np.concatenate([values, values[vertices]]) for values in per_vertex
        )
        self._is_divided = _find_divided(self.fine_vertices)
        self.perceptual.append(vertices)
        order.append(copies)

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
        costs = order.rate(self, collapses)
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
        order.apply(self, collapses)
        self.values.append(self.perceptual.record(self.topology, collapses.removed, collapses.kept))
        self.removed.append(collapses.removed)
        self.kept.append(collapses.kept)
        changed = np.unique(fans.neighbors[1])
        replaced = fans.topology.wedges[fans.corners]
        replaced = replaced[replaced != fans.wedges]
        self.triangles.reshape(-1)[fans.corners] = collapses.kept[fans.owners]
        self.wedges.reshape(-1)[fans.corners] = fans.wedges
        is_kept = np.ones(self.triangle_count, bool)
        is_kept[fans.triangles[fans.vanishes]] = False
        self._keep(is_kept)
        self._is_waiting[changed] = False
        order.drop_wedges(*self._find_dropped_wedges(fans, replaced))
        order.mark_changed(changed)
        self.rebuild()
        if self.placement is not None:
            self._place(np.unique(collapses.kept))

    def _place(self, vertices: np.ndarray) -> None:
        """Move `vertices` (N,) to where they cost least, but at most as far as their farthest neighbors are, and fold no triangle."""
        topology, positions = self.topology, self.surface.positions
        vertices = vertices[topology.is_used[vertices] & ~self._is_divided[vertices]]
        owners, corners = topology.find_corners(vertices)
        edges = positions[:, topology.ends[corners]] - positions[:, vertices[owners]]
        limits = np.zeros(len(vertices))
        np.maximum.at(limits, owners, np.linalg.norm(edges, axis=0))
        triangles = self.triangles[:, np.unique(corners % topology.triangle_count)]
        steps = shorten_steps(self.surface, triangles, vertices, self.placement.find_steps(vertices, limits))
        positions[:, vertices] += steps.T
        starts, wedges = topology.vertex_wedges
        counts = starts[vertices + 1] - starts[vertices]
        self.placement.move(
            vertices, steps, np.repeat(np.arange(len(vertices)), counts), wedges[concatenate_ranges(starts[vertices], counts)]
        )

    def _find_dropped_wedges(self, fans: CollapseFans, replaced: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the wedges (N,) whose last triangles vanished with the collapses of `fans`, and the vertices (N,) where they were.
        replaced: (M,), wedges that others replace."""
        starts, wedges = fans.topology.vertex_wedges
        is_used = np.zeros(len(self.groups), bool)
        is_used[self.wedges] = True
        is_used[replaced] = True  # They are no longer needed.
        rows = np.flatnonzero(~is_used[wedges])
        vertices = np.searchsorted(starts, rows, side="right") - 1
        homes = np.arange(len(starts) - 1)
        homes[fans.collapses.removed] = fans.collapses.kept
        return wedges[rows], homes[vertices]


def _find_divided(fine_vertices: np.ndarray) -> np.ndarray:
    """Return which vertices (V,) bool have the same one of `fine_vertices` (V,) as others."""
    return np.bincount(fine_vertices)[fine_vertices] > 1
