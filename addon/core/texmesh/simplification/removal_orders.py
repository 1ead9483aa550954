"""Orders of removal: by given priorities, or by the cost of the cheapest collapse.

Costs are quadrics of position and texture coordinates, one per wedge, evaluated at the wedge that is kept. After Garland and Heckbert,
Simplifying surfaces with color and texture using quadric error metrics, 1998. Texture coordinates are scaled by the local ratio of lengths
in space and in texture space, so that a distance between them is one on the surface. Seams and boundaries add the squared distance from
their edges within the triangle's plane in (x, y, z, u, v).
"""

from typing import Protocol

import numpy as np

from ...arrays import TINY
from ...geometry.mesh import face_areas_and_normals, longest_side, scaled_normals
from ...geometry.transforms import signed_areas
from ..textured_mesh import TexturedMesh
from .engine import CollapseEngine, Copies, WedgeMoves
from .topology import BOUNDARY, Collapses, Topology, build_topology, find_islands
from .wedge_quadrics import COLUMNS, ROWS, WedgeQuadrics

TIED_FRACTION = 0.01  # Perceptual values break ties if more than this fraction of the priorities are equal to others.
WEIGHT_PER_SCALE = 1.15  # factor of the cost of a vertex per scale at which it is a feature: 1.1 to 1.25 gave the least visible levels
MAX_COST_RATIO = 1e3  # A round has no collapse that costs this many times more than its cheapest one.
CHUNK_SIZE = 1 << 14  # triangles
MAX_SCALE_RATIO = 4.0  # between the UV scales of a triangle and of its island
BOUNDARY_WEIGHT = 0.5  # Weight of a squared distance from an edge of a boundary, or of a border of colors, times its squared length.
SEAM_WEIGHT = 0.02  # likewise of a seam. The texture beyond it is there in the neighboring island, so that more only costs accuracy
LENGTH_WEIGHT = 1e-6  # Weight of the squared length of a collapse, which decides where the surface and its texture coordinates are flat.


class CollapseCost(Protocol):
    """A cost of half-edge collapses that changes as collapses are performed. Vertices and wedges are those of `CollapseEngine.mesh`."""

    def evaluate(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """Return the costs (N,) float64 of `collapses`, infinite for those that must not happen."""

    def merge(self, collapses: Collapses, moves: WedgeMoves) -> None:
        """Take note of `collapses` that are performed."""

    def drop_wedges(self, wedges: np.ndarray, vertices: np.ndarray) -> None:
        """See `RemovalOrder`."""

    def append(self, copies: Copies) -> None:
        """See `RemovalOrder`."""


class GivenOrder:
    """Vertices with low priorities are removed first, and collapse onto the nearest neighbor. Ties are broken by perceptual values."""

    def __init__(self, positions: np.ndarray, priorities: np.ndarray, protected_fraction: float) -> None:
        """positions: (3, V). priorities: (V,) float64. protected_fraction: see `TexmeshSettings.protected_fraction`."""
        self._positions, self._priorities, self._protected_fraction = positions, priorities, protected_fraction
        self.min_cost = 0.0
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

    def rate(self, engine: CollapseEngine, collapses: Collapses) -> np.ndarray:
        """Return the squared distances (N,) to the kept vertices."""
        return ((self._positions[:, collapses.removed] - self._positions[:, collapses.kept]) ** 2).sum(axis=0)

    def select(self, vertices: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """See `RemovalOrder`."""
        return np.ones(len(costs), bool)

    def apply(self, engine: CollapseEngine, collapses: Collapses) -> None:
        """See `RemovalOrder`."""

    def drop_wedges(self, wedges: np.ndarray, vertices: np.ndarray) -> None:
        """See `RemovalOrder`."""

    def mark_changed(self, vertices: np.ndarray) -> None:
        """See `RemovalOrder`."""
        self._is_stale[vertices] = self._needs_values

    def append(self, copies: Copies) -> None:
        """See `RemovalOrder`."""
        self._positions = np.concatenate([self._positions, self._positions[:, copies.vertices]], axis=1)
        columns = (self._priorities, self._values, self._is_stale)
        self._priorities, self._values, self._is_stale = (np.concatenate([values, values[copies.vertices]]) for values in columns)


class CheapestOrder:
    """Vertices with the cheapest collapses are removed first. Costs are evaluated again only for vertices that may be among them."""

    def __init__(self, cost: CollapseCost, vertex_count: int) -> None:
        self._cost = cost
        self._costs = np.zeros(vertex_count)
        self._is_stale = np.ones(vertex_count, bool)
        self._cutoff, self.min_cost = np.inf, 0.0

    def choose_window(self, engine: CollapseEngine, vertices: np.ndarray, size: int) -> np.ndarray:
        """See `RemovalOrder`."""
        size = min(size, len(vertices))
        window = vertices[np.argpartition(self._costs[vertices], size - 1)[:size]] if not self._is_stale.all() else vertices
        stale = window[self._is_stale[window]]
        owners, collapses = engine.topology.find_collapses(stale, engine.groups)
        costs = np.full(len(stale), np.inf)
        np.minimum.at(costs, owners, self.rate(engine, collapses))
        self._costs[stale] = costs
        self._is_stale[stale] = False
        window = window[np.argsort(self._costs[window], kind="stable")]
        self.min_cost = float(self._costs[window[0]])
        self._cutoff = min(np.partition(self._costs[vertices], size - 1)[size - 1], MAX_COST_RATIO * max(self._costs[window[0]], 0.0))
        cheap = window[self._costs[window] <= self._cutoff]
        return cheap[:size]

    def rate(self, engine: CollapseEngine, collapses: Collapses) -> np.ndarray:
        """Return the costs (N,)."""
        return self._cost.evaluate(collapses, engine.find_moves(collapses))

    def select(self, vertices: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """See `RemovalOrder`."""
        self._costs[vertices] = costs
        return costs <= self._cutoff

    def apply(self, engine: CollapseEngine, collapses: Collapses) -> None:
        """See `RemovalOrder`."""
        self._cost.merge(collapses, engine.find_moves(collapses))

    def drop_wedges(self, wedges: np.ndarray, vertices: np.ndarray) -> None:
        """See `RemovalOrder`."""
        self._cost.drop_wedges(wedges, vertices)

    def mark_changed(self, vertices: np.ndarray) -> None:
        """See `RemovalOrder`."""
        self._is_stale[vertices] = True

    def append(self, copies: Copies) -> None:
        """See `RemovalOrder`."""
        columns = (self._costs, self._is_stale)
        self._costs, self._is_stale = (np.concatenate([values, values[copies.vertices]]) for values in columns)
        self._cost.append(copies)


class TextureQuadrics(WedgeQuadrics):
    """A `CollapseCost`: sums of squared distances to the triangles and curves that a wedge stands for, weighted by area."""

    def __init__(self, mesh: TexturedMesh) -> None:
        unit = 1.0 / max(longest_side(mesh.vertices), TINY)
        positions = (mesh.vertices - mesh.vertices.mean(axis=0)) * unit
        scales, overall = _find_uv_scales(mesh, unit)
        points = np.concatenate([positions[mesh.wedge_vertices], mesh.uvs * overall], axis=1)
        super().__init__(mesh, points, face_areas_and_normals(positions[mesh.triangles])[0], moves_vertices=False)
        triangles = np.ascontiguousarray(mesh.triangles.T)
        wedges = np.ascontiguousarray(mesh.wedge_triangles.T)
        topology = build_topology(triangles, wedges, np.arange(len(points)), np.zeros(len(mesh.vertices), bool))
        curve_weights = np.where(topology.is_curve, SEAM_WEIGHT, 0.0)
        curve_weights[(topology.twins == BOUNDARY) | _find_color_borders(mesh, topology)] = BOUNDARY_WEIGHT
        curve_weights = curve_weights.reshape(3, -1)
        for start in range(0, len(mesh.triangles), CHUNK_SIZE):
            rows = slice(start, start + CHUNK_SIZE)
            self._add_triangles(points, mesh.wedge_triangles[rows], scales[rows] / overall, curve_weights[:, rows])
        self.finish()

    def evaluate(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """See `CollapseCost`."""
        costs, removed = self.evaluate_wedges(collapses, moves), collapses.removed_wedges[0]
        displacements = self._positions[collapses.removed] - self._positions[collapses.kept]
        return costs + LENGTH_WEIGHT * self._areas[removed] * np.einsum("ij,ij->i", displacements, displacements)

    def _add_triangles(self, points: np.ndarray, wedges: np.ndarray, scales: np.ndarray, curve_weights: np.ndarray) -> None:
        """Add the quadrics of triangles `wedges` (T, 3), and of their edges with `curve_weights` (3, T), to those of their wedges.

        scales: (T,), of the texture coordinates in `points` (W, 5).
        """
        corners = points[wedges]
        corners[:, :, 3:] *= scales[:, None, None]
        areas = 0.5 * np.linalg.norm(scaled_normals(corners[:, :, :3]), axis=1)
        first = _normalize(corners[:, 1] - corners[:, 0])
        second = _normalize(_reject(corners[:, 2] - corners[:, 0], first))
        offsets = _to_offsets(corners[:, 0], scales)
        in_plane = [np.einsum("ti,tij->tj", axis, offsets) for axis in (first, second)]
        terms = np.einsum("tik,tik->tk", offsets[:, :, ROWS], offsets[:, :, COLUMNS])
        for axis in in_plane:
            terms -= axis[:, ROWS] * axis[:, COLUMNS]
        for corner in range(3):
            np.add.at(self._quadrics, wedges[:, corner], terms * areas[:, None] / 3.0)
            np.add.at(self._areas, wedges[:, corner], areas / 3.0)
        for corner in range(3):
            rows = np.flatnonzero(curve_weights[corner])
            start, end, apex = (corners[rows, (corner + step) % 3] for step in range(3))
            edge = end - start
            inward = _normalize(_reject(apex - start, _normalize(edge)))
            distances = np.einsum("ti,tij->tj", inward, _to_offsets(start, scales[rows]))
            weights = curve_weights[corner, rows] * np.einsum("ti,ti->t", edge[:, :3], edge[:, :3])
            curve_terms = distances[:, ROWS] * distances[:, COLUMNS] * weights[:, None]
            np.add.at(self._quadrics, wedges[rows, corner], curve_terms)
            np.add.at(self._quadrics, wedges[rows, (corner + 1) % 3], curve_terms)


class ScaleWeightedQuadrics(TextureQuadrics):
    """Texture quadrics, weighted by the last scale at which the removed vertex is a feature."""

    def __init__(self, mesh: TexturedMesh, last_scales: np.ndarray) -> None:
        """last_scales: (V,) int, see `ScaleMap`."""
        super().__init__(mesh)
        self._weights = WEIGHT_PER_SCALE ** last_scales.astype(np.float64)

    def evaluate(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """See `CollapseCost`."""
        return super().evaluate(collapses, moves) * self._weights[collapses.removed]

    def append(self, copies: Copies) -> None:
        """See `RemovalOrder`."""
        super().append(copies)
        self._weights = np.concatenate([self._weights, self._weights[copies.vertices]])


def _find_color_borders(mesh: TexturedMesh, topology: Topology) -> np.ndarray:
    """Return which halfedges (3 T,) bool are seams between materials or vertex colors."""
    halfedges = np.flatnonzero(topology.is_curve & (topology.twins >= 0))
    twins = topology.twins[halfedges]
    is_border = mesh.materials[halfedges % topology.triangle_count] != mesh.materials[twins % topology.triangle_count]
    for own, other in ((halfedges, topology.next(twins)), (topology.next(halfedges), twins)):
        is_border |= (mesh.colors[topology.wedges[own]] != mesh.colors[topology.wedges[other]]).any(axis=1)
    found = np.zeros(len(topology.twins), bool)
    found[halfedges[is_border]] = True
    return found


def _find_uv_scales(mesh: TexturedMesh, unit: float) -> tuple[np.ndarray, float]:
    """Return the length in space of one in texture space for each triangle (T,), limited by that of its island, and for all."""
    uv_areas = np.abs(signed_areas(mesh.corner_uvs))
    areas = 0.5 * np.linalg.norm(scaled_normals(mesh.vertices[mesh.triangles] * unit), axis=1)
    overall = _find_scale(areas.sum(), uv_areas.sum(), 1.0)
    islands = find_islands(mesh)
    island_scales = _find_scale(np.bincount(islands, areas), np.bincount(islands, uv_areas), overall)[islands]
    scales = _find_scale(areas, uv_areas, island_scales)
    return np.clip(scales, island_scales / MAX_SCALE_RATIO, island_scales * MAX_SCALE_RATIO), float(overall)


def _find_scale(areas: np.ndarray, uv_areas: np.ndarray, default: np.ndarray | float) -> np.ndarray:
    return np.where(uv_areas > 0.0, np.sqrt(areas / np.maximum(uv_areas, TINY)), default)


def _to_offsets(origins: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return matrices (T, 5, 6) that map homogeneous points to scaled offsets from `origins` (T, 5), which are scaled already."""
    matrices = np.zeros((len(origins), 5, 6))
    matrices[:, [0, 1, 2], [0, 1, 2]] = 1.0
    matrices[:, [3, 4], [3, 4]] = scales[:, None]
    matrices[:, :, 5] = -origins
    return matrices


def _reject(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return `vectors` (T, 5) without their components along unit `axes` (T, 5)."""
    return vectors - np.einsum("ti,ti->t", vectors, axes)[:, None] * axes


def _normalize(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1), TINY)[:, None]
