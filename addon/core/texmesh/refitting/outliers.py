"""Outliers: the places of a level that are much farther from the fine mesh than most, by the true distance from both sides.

Least squares between equal texture coordinates leave them where few samples lie: at edges that bridge a valley, next to small triangles,
and beyond concave boundaries, where the fine mesh has no texture coordinates. The mean hardly shows them; renders do.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from scipy.spatial import cKDTree

from ...arrays import TINY, find_last_positions
from ...geometry.distance import TriangleTree, closest_barycentric, squared_point_triangle_distances
from ...geometry.edges import Edges
from ...geometry.mesh import face_areas_and_normals, longest_side
from ..textured_mesh import TexturedMesh
from .correspondence import (
    Correspondence,
    SurfaceSamples,
    UvTriangles,
    compute_uv_scale,
    find_in_triangles,
    find_textured_islands,
    match_islands,
)
from .level_state import LevelState, attach

LIMIT_FACTOR = 4.5  # Points farther than this multiple of the root mean squared distance are outliers.
MIN_LIMIT = 1e-9  # Relative to the size of the level; smaller distances are rounding.
MAX_OUTLIER_FRACTION = 0.01  # If more of the vertices and midpoints of edges are outliers, the limit is larger.
EDGE_FRACTIONS = np.array([0.25, 0.5, 0.75])  # along an edge, where its distance is measured
NEAR_FRACTION = 0.5  # If midpoint and ends of an edge are within this fraction of the limit, no point of it is an outlier.
ATTRACTED_FRACTION = 0.9  # Points beyond this fraction of the limit are attracted, so that they do not become outliers.


@dataclass(frozen=True)
class FineSurface:
    """The fine mesh that levels are measured from, and the UV islands (T,) of its triangles."""

    mesh: TexturedMesh
    islands: np.ndarray

    @classmethod
    def of(cls, mesh: TexturedMesh) -> Self:
        """Return the surface of a mesh."""
        return cls(mesh, find_textured_islands(mesh))

    @cached_property
    def uv_scale(self) -> float:
        """See `compute_uv_scale`."""
        return compute_uv_scale(self.mesh)

    def attach(self, level: TexturedMesh, samples: SurfaceSamples, normal_weight: float) -> LevelState:
        """Return the state of a level with corresponding points for all `samples` of the surface."""
        islands = match_islands(samples, self.mesh.materials[samples.triangles], level, self.uv_scale)
        return attach(level, islands, samples, normal_weight)

    def find_closest(self, points: np.ndarray, enough: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (N,) of `points` (N, 3) from the surface, and the nearest triangles (N,). Distances up to `enough`, one or
        (N,), may be upper bounds, those from another triangle."""
        return self.tree.find_closest(points, enough)

    def measure_distances(self, points: np.ndarray, enough: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the distances alone, see `find_closest`."""
        return self.find_closest(points, enough)[0]

    @cached_property
    def corners(self) -> np.ndarray:
        """(T, 3, 3) float64 positions of the corners of the triangles."""
        return self.mesh.vertices[self.mesh.triangles]

    @cached_property
    def tree(self) -> TriangleTree:
        """The triangles, for searches."""
        return TriangleTree(self.corners)

    @cached_property
    def _uv_triangles(self) -> UvTriangles:
        return UvTriangles(self.mesh.corner_uvs, self.islands)

    def find_positions(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the points (N, 3) of the surface with texture coordinates `uvs` (N, 2) in `islands` (N,); of several the nearest to
        `points` (N, 3)."""
        found = self.find_points(points, uvs, islands)
        return np.einsum("ni,nic->nc", found.barycentric, self.corners[found.triangles])

    def find_normals(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the unit normals (N, 3) of the surface at the same points."""
        return face_areas_and_normals(self.corners[self.find_points(points, uvs, islands).triangles])[1]

    def find_points(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> Correspondence:
        """Return these points of the surface by triangle; where an island does not have the coordinates, the ones nearest to them there."""
        blank = np.zeros(len(points))
        samples = SurfaceSamples(blank.astype(np.int64), np.zeros((len(points), 3)), points, uvs, islands, blank)
        return find_in_triangles(samples, self.corners, self._uv_triangles)


@dataclass(frozen=True)
class LevelDistances:
    """How far a level is from the fine mesh.

    Attributes:
        vertices: (V, 3) of the level.
        edges: its E edges.
        at_vertices: (V,) distances of its vertices.
        at_edges: (E, 3) distances of the points EDGE_FRACTIONS of its edges, from the lower vertex to the other one. Distances far below
            the limit are upper bounds or estimates.
        triangles, barycentric, targets: K points of the level, and the points of the fine mesh (K, 3) that they should be nearer to: the
            nearest ones of distant points of the level, then distant samples of the fine mesh.
        distances: (K,) between them.
        missed: (M,) the samples that are the last of the targets.
        limit: the distance above which points are outliers.
    """

    vertices: np.ndarray
    edges: Edges
    at_vertices: np.ndarray
    at_edges: np.ndarray
    triangles: np.ndarray
    barycentric: np.ndarray
    targets: np.ndarray
    distances: np.ndarray
    missed: np.ndarray
    limit: float

    @cached_property
    def peaks(self) -> np.ndarray:
        """(E,) largest distances of the points of edges."""
        return np.maximum.reduce(np.ascontiguousarray(self.at_edges.T))


def measure_distances(state: LevelState, surface: FineSurface, previous: LevelDistances | None = None) -> LevelDistances:
    """Measure a level from both sides.

    previous: of the level before vertices moved, edges flipped or vertices were appended. Where it shows that a point can be no outlier,
    the point is not measured again.
    """
    edges = state.edges
    points = gather_points(state.mesh.vertices, edges)
    if previous is None:
        distances, is_near, limit = _measure_coarsely(points, edges, surface, _find_min_limit(state))
        lowest = ATTRACTED_FRACTION * limit
    else:
        limit = previous.limit
        lowest = ATTRACTED_FRACTION * limit
        distances = _bound_distances(state.mesh.vertices, edges, previous)
        is_near = distances <= lowest
    rows = np.flatnonzero(~is_near)
    distances[rows], nearest = surface.find_closest(points[rows], lowest)
    is_far = distances[rows] > lowest
    far, nearest = rows[is_far], nearest[is_far]
    triangles, barycentric = _locate(state, edges, far)
    fine_corners = surface.corners[nearest]
    targets = np.einsum("ni,nic->nc", closest_barycentric(points[far], fine_corners), fine_corners)
    missed, missed_triangles, missed_distances = _find_missed(state, lowest)
    missed_points = state.samples.positions[missed]
    count = len(state.mesh.vertices)
    return LevelDistances(
        vertices=state.mesh.vertices,
        edges=edges,
        at_vertices=distances[:count],
        at_edges=distances[count:].reshape(-1, len(EDGE_FRACTIONS)),
        triangles=np.concatenate([triangles, missed_triangles]),
        barycentric=np.concatenate([barycentric, closest_barycentric(missed_points, state.corners[missed_triangles])]),
        targets=np.concatenate([targets, missed_points]),
        distances=np.concatenate([distances[far], missed_distances]),
        missed=missed,
        limit=limit,
    )


def _measure_coarsely(points: np.ndarray, edges: Edges, surface: FineSurface, min_limit: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return estimates of the distances of `points` (N, 3) from those of vertices and midpoints of edges, which are near, (N,) bool, and
    the limit above which they are outliers, at least `min_limit`."""
    count = edges.vertex_count
    midpoints = count + len(EDGE_FRACTIONS) * np.arange(len(edges.ends)) + len(EDGE_FRACTIONS) // 2
    measured = np.concatenate([np.arange(count), midpoints])
    distances = np.empty(len(points))
    distances[measured] = surface.measure_distances(points[measured], NEAR_FRACTION * min_limit)
    limit = max(min_limit, float(np.quantile(distances[measured], 1.0 - MAX_OUTLIER_FRACTION)))
    highest = np.maximum(distances[midpoints], distances[edges.ends].max(axis=1))
    distances[count:] = np.repeat(highest, len(EDGE_FRACTIONS))
    return distances, distances <= NEAR_FRACTION * limit, limit


def _bound_distances(vertices: np.ndarray, edges: Edges, previous: LevelDistances) -> np.ndarray:
    """Return upper bounds (N,) of the distances of vertices and points of edges; infinite where there were none before."""
    count, last = len(previous.vertices), previous.edges
    moves = np.linalg.norm(vertices[:count] - previous.vertices, axis=1)
    at_vertices = np.full(len(vertices), np.inf)
    at_vertices[:count] = previous.at_vertices + moves
    at_edges = np.full((len(edges.ends), len(EDGE_FRACTIONS)), np.inf)
    rows = np.flatnonzero((edges.ends < count).all(axis=1))
    old = last.between(*edges.ends[rows].T)
    rows, old = rows[old >= 0], old[old >= 0]
    at_edges[rows] = previous.at_edges[old] + moves[edges.ends[rows]].max(axis=1, keepdims=True)
    return np.concatenate([at_vertices, at_edges.ravel()])


def _find_missed(state: LevelState, distance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the samples (M,) that are farther than `distance` from the level, and their nearest triangles and distances, (M,) each."""
    _, normals = state.areas_and_normals
    along = np.abs(np.einsum("ni,ni->n", state.residuals, normals[state.found.triangles]))
    squares = np.einsum("ni,ni->n", state.residuals, state.residuals)
    is_doubtful = (squares > distance**2) & ((along > NEAR_FRACTION * distance) | ~state.found.is_covered)
    rows = np.flatnonzero(is_doubtful)
    own = state.corners[state.found.triangles[rows]]
    bounds = np.sqrt(squared_point_triangle_distances(state.samples.positions[rows], own))
    rows, bounds = rows[bounds > distance], bounds[bounds > distance]
    if not len(rows):
        return rows, np.zeros(0, np.int64), bounds
    near = _find_triangles_near(state, state.samples.positions[rows], bounds.max())
    distances, nearest = TriangleTree(state.corners[near]).find_closest(state.samples.positions[rows])
    is_far = distances > distance
    return rows[is_far], near[nearest[is_far]], distances[is_far]


def _find_triangles_near(state: LevelState, points: np.ndarray, distance: float) -> np.ndarray:
    """Return all triangles (K,) with a part within `distance` of any of `points` (N, 3), and others whose centroids are near."""
    centroids = state.corners.mean(axis=1)
    radii = np.sqrt(((state.corners - centroids[:, None]) ** 2).sum(axis=2).max(axis=1))
    return np.flatnonzero(cKDTree(points).query(centroids)[0] <= distance + radii)


def gather_points(vertices: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the points (V + 3 E, 3) that are measured: vertices, then the points of edges at EDGE_FRACTIONS."""
    first, second = vertices[edges.ends[:, 0]], vertices[edges.ends[:, 1]]
    points = first[:, None] + EDGE_FRACTIONS[:, None] * (second - first)[:, None]
    return np.concatenate([vertices, points.reshape(-1, 3)])


def gather_some_points(vertices: np.ndarray, edges: Edges, rows: np.ndarray) -> np.ndarray:
    """Return the points `rows` (N,), ascending, of those of `gather_points`."""
    count = np.searchsorted(rows, len(vertices))
    edge, place = np.divmod(rows[count:] - len(vertices), len(EDGE_FRACTIONS))
    first, second = (vertices.take(ends, axis=0) for ends in edges.ends[edge].T)
    return np.concatenate([vertices[rows[:count]], first + EDGE_FRACTIONS[place, None] * (second - first)])


def _locate(state: LevelState, edges: Edges, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (N,) and barycentric coordinates (N, 3) of the measured points `rows` (N,): vertices, then points of edges."""
    mesh = state.mesh
    corners = find_last_positions(mesh.triangles.ravel(), len(mesh.vertices))
    halfedges = find_last_positions(edges.face_edges.ravel(), len(edges.ends))
    triangles, barycentric = np.zeros(len(rows), np.int64), np.zeros((len(rows), 3))
    is_vertex = rows < len(mesh.vertices)
    at = np.flatnonzero(is_vertex)
    triangles[at] = corners[rows[at]] // 3
    barycentric[at, corners[rows[at]] % 3] = 1.0
    at = np.flatnonzero(~is_vertex)
    edge, place = np.divmod(rows[at] - len(mesh.vertices), len(EDGE_FRACTIONS))
    triangle, corner = halfedges[edge] // 3, halfedges[edge] % 3
    triangles[at] = triangle
    for step in (1, 2):
        is_low = mesh.triangles[triangle, (corner + step) % 3] == edges.ends[edge, 0]
        barycentric[at, (corner + step) % 3] = np.where(is_low, 1.0 - EDGE_FRACTIONS[place], EDGE_FRACTIONS[place])
    return triangles, barycentric


def _find_min_limit(state: LevelState) -> float:
    """Return the least limit: a multiple of the root mean squared distance of the samples from the planes of their triangles, by area."""
    _, normals = state.areas_and_normals
    along = np.einsum("ni,ni->n", state.residuals, normals[state.found.triangles])
    rms = np.sqrt((along**2 * state.samples.weights).sum() / max(state.samples.weights.sum(), TINY))
    return max(LIMIT_FACTOR * float(rms), MIN_LIMIT * longest_side(state.mesh.vertices), TINY)
