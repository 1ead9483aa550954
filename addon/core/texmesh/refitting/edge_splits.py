"""Edge splits of a level where it is farthest from the fine mesh."""

from dataclasses import dataclass, replace

import numpy as np

from ...geometry.edges import Edges
from ...geometry.mesh import scaled_normals
from ...geometry.transforms import signed_areas
from .border_curves import BorderCurves
from .edge_flips import select_largest
from .level_state import LevelState, attach
from .outliers import FineSurface, LevelDistances

SHORT_EDGE_FACTOR = 0.25  # Factor of the deviation for edges that are not the longest of their triangle.
MIN_UV_FRACTION = 0.1  # area of a new triangle in UV space relative to the one that is divided
MIN_CANDIDATES, CANDIDATES_PER_TRIANGLE = 32, 4  # edges that are examined, and more of them per added triangle
MAX_CURVE_DISTANCE = 0.5  # An edge on a border is not split farther from the border of the fine mesh than this fraction of its length.


@dataclass(frozen=True)
class SplitEdges:
    """Edges that may be split.

    edges: (K,) of the level. first, second: (K,) halfedges, 3 t + c is opposite to corner c of triangle t; second is -1 on a boundary.
    is_border: (K,) bool, seams and boundaries.
    """

    edges: np.ndarray
    first: np.ndarray
    second: np.ndarray
    is_border: np.ndarray

    def take(self, rows: np.ndarray) -> "SplitEdges":
        """Return the edges of `rows` (R,)."""
        return SplitEdges(self.edges[rows], self.first[rows], self.second[rows], self.is_border[rows])

    @property
    def triangles(self) -> np.ndarray:
        """(K, 2) triangles at the edges, the same one twice on a boundary."""
        return np.stack([self.first // 3, np.where(self.second >= 0, self.second, self.first) // 3], axis=1)


def split_edges(state: LevelState, count: int) -> LevelState:
    """Return the level with up to `count` edges split at their middle: those of triangles with the largest deviation along the normal.

    Each adds two triangles. Seams and boundaries are not split. No two of the edges have a triangle in common.
    """
    edges = state.edges
    found = find_split_edges(state, edges)
    found = found.take(np.flatnonzero(~found.is_border))
    chosen = _choose(found, rate_edges(state, edges, found, find_peaks(state)), 2 * count, len(state.mesh.triangles))
    found = found.take(chosen)
    starts, ends = (_wedges(state, found.first, step) for step in (1, 2))
    uvs = 0.5 * (state.mesh.uvs[starts] + state.mesh.uvs[ends])
    points = 0.5 * (_end_points(state, found.first, 1) + _end_points(state, found.first, 2))
    return _split(state, found, points, uvs, uvs)


def split_far_edges(state: LevelState, measured: LevelDistances, count: int, surface: FineSurface, curves: BorderCurves) -> LevelState:
    """Return the level with its farthest edges split, seams and boundaries too, so that there are up to `count` more triangles.

    New vertices are at the sample of the fine mesh that is farthest from the level, if that is at the edge. Else they are on the fine
    surface, at the middle of the edge in UV space or on the border next to it. No two of the edges have a triangle in common.

    Args:
        measured: of `state`.
    """
    mesh = state.mesh
    found = find_split_edges(state, measured.edges)
    starts, ends = (_wedges(state, found.first, step) for step in (1, 2))
    uvs = 0.5 * (mesh.uvs[starts] + mesh.uvs[ends])
    others = uvs.copy()
    is_valid = np.ones(len(found.first), bool)
    rows = np.flatnonzero(found.is_border)
    if len(rows):
        uvs[rows], others[rows], is_valid[rows] = _find_border_points(state, found.take(rows), curves)
    points = 0.5 * (_end_points(state, found.first, 1) + _end_points(state, found.first, 2))
    scores = np.where(is_valid, measured.peaks[found.edges], 0.0)
    rows, samples, distances = _find_missed_edges(state, measured, found)
    rows, samples, distances = (values[distances > scores[rows]] for values in (rows, samples, distances))
    scores[rows], points[rows] = distances, state.samples.positions[samples]
    uvs[rows] = others[rows] = state.samples.uvs[samples]
    has_point = np.zeros(len(scores), bool)
    has_point[rows] = True
    candidates = np.argsort(-scores, kind="stable")[: CANDIDATES_PER_TRIANGLE * count + MIN_CANDIDATES]
    sought = candidates[~has_point[candidates]]
    points[sought] = surface.find_positions(points[sought], uvs[sought], state.islands[found.first[sought] // 3])
    is_proper = np.zeros(len(scores), bool)
    is_proper[candidates] = _is_proper(state, found.take(candidates), points[candidates], uvs[candidates], others[candidates])
    chosen = _choose(found, np.where(is_proper, scores, 0.0), count, len(mesh.triangles))
    return _split(state, found.take(chosen), points[chosen], uvs[chosen], others[chosen])


def _find_missed_edges(state: LevelState, measured: LevelDistances, found: SplitEdges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rows (R,) of edges `found` at which the level misses samples, the farthest sample (R,) of each, and its distance."""
    place = np.full(len(measured.edges.ends), -1)
    place[found.edges[~found.is_border]] = np.flatnonzero(~found.is_border)
    samples, distances = measured.missed, measured.distances[len(measured.distances) - len(measured.missed) :]
    corners = state.found.barycentric[samples].argmin(axis=1)
    rows = place[measured.edges.face_edges[state.found.triangles[samples], corners]]
    is_used = (rows >= 0) & state.found.is_covered[samples]
    rows, samples, distances = rows[is_used], samples[is_used], distances[is_used]
    order = np.lexsort((-distances, rows))
    rows, first = np.unique(rows[order], return_index=True)
    return rows, samples[order][first], distances[order][first]


def find_split_edges(state: LevelState, edges: Edges) -> SplitEdges:
    """Return the interior and boundary edges of the level."""
    interior = edges.interior
    boundary = np.flatnonzero(edges.face_counts == 1)
    halfedges = np.zeros(len(edges.ends), np.int64)
    halfedges[edges.face_edges.ravel()] = np.arange(edges.face_edges.size)
    first, second = edges.interior_halfedges.T
    return SplitEdges(
        np.concatenate([interior, boundary]),
        np.concatenate([first, halfedges[boundary]]),
        np.concatenate([second, np.full(len(boundary), -1)]),
        np.concatenate([state.mesh.find_seams(edges)[interior], np.ones(len(boundary), bool)]),
    )


def rate_edges(state: LevelState, edges: Edges, found: SplitEdges, peaks: np.ndarray) -> np.ndarray:
    """Return for each of the edges `found` (K,) the larger of the `peaks` (T,) at it, less where it is not the longest edge."""
    lengths = np.linalg.norm(np.diff(state.mesh.vertices[edges.ends], axis=1)[:, 0], axis=1)
    longest = lengths[edges.face_edges].max(axis=1)
    areas, _ = state.areas_and_normals
    sides = found.triangles
    factors = np.where(lengths[found.edges][:, None] >= longest[sides], 1.0, SHORT_EDGE_FACTOR)
    return (factors * peaks[sides]).max(axis=1) * (areas[sides] > 0.0).all(axis=1)


def find_peaks(state: LevelState) -> np.ndarray:
    """Return the largest distance (T,) of the samples of each triangle from its plane."""
    _, normals = state.areas_and_normals
    triangles = state.found.triangles
    along = np.abs(np.einsum("ni,ni->n", state.residuals, normals[triangles]))
    peaks = np.zeros(len(state.islands))
    np.maximum.at(peaks, triangles, along)
    return peaks


def _choose(found: SplitEdges, scores: np.ndarray, count: int, triangle_count: int) -> np.ndarray:
    """Return the rows of edges with large `scores` (K,) that share no triangle and add up to `count` triangles."""
    chosen = select_largest(scores, found.triangles, triangle_count)
    chosen = chosen[np.argsort(-scores[chosen], kind="stable")]
    return chosen[np.cumsum(np.where(found.second[chosen] >= 0, 2, 1)) <= count]


def _find_border_points(state: LevelState, found: SplitEdges, curves: BorderCurves) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the texture coordinates (K, 2) of new vertices on both sides of seams or boundaries, and whether they exist, (K,) bool."""
    mesh = state.mesh
    starts, ends = (mesh.uvs[_wedges(state, found.first, step)] for step in (1, 2))
    uvs, others = curves.project(0.5 * (starts + ends), state.islands[found.first // 3])
    limits = MAX_CURVE_DISTANCE * np.linalg.norm(ends - starts, axis=1)
    is_valid = np.linalg.norm(uvs - 0.5 * (starts + ends), axis=1) <= limits
    rows = np.flatnonzero(found.second >= 0)
    starts, ends = (mesh.uvs[_wedges(state, found.second[rows], step)] for step in (1, 2))
    limits = MAX_CURVE_DISTANCE * np.linalg.norm(ends - starts, axis=1)
    is_valid[rows] &= np.linalg.norm(others[rows] - 0.5 * (starts + ends), axis=1) <= limits  # False for NaN
    return uvs, others, is_valid


def _is_proper(state: LevelState, found: SplitEdges, points: np.ndarray, uvs: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return for which edges (K,) bool new vertices at `points` (K, 3) fold no triangle, in space and in UV space."""
    mesh = state.mesh
    is_proper = np.ones(len(points), bool)
    for halfedges, new_uvs in ((found.first, uvs), (found.second, others)):
        rows = np.flatnonzero(halfedges >= 0)
        faces, corners = halfedges[rows] // 3, halfedges[rows] % 3
        old_area, old_normal = signed_areas(mesh.corner_uvs[faces]), scaled_normals(state.corners[faces])
        for step in (1, 2):
            uv_corners, space_corners = mesh.corner_uvs[faces], state.corners[faces]
            uv_corners[np.arange(len(rows)), (corners + step) % 3] = new_uvs[rows]
            space_corners[np.arange(len(rows)), (corners + step) % 3] = points[rows]
            is_proper[rows] &= signed_areas(uv_corners) * np.sign(old_area) >= MIN_UV_FRACTION * np.abs(old_area)
            is_proper[rows] &= np.einsum("ni,ni->n", scaled_normals(space_corners), old_normal) > 0.0
    return is_proper


def _wedges(state: LevelState, halfedges: np.ndarray, step: int) -> np.ndarray:
    """Return the wedges (N,) at the starts, step 1, or ends, step 2, of halfedges (N,)."""
    return state.mesh.wedge_triangles[halfedges // 3, (halfedges % 3 + step) % 3]


def _end_points(state: LevelState, halfedges: np.ndarray, step: int) -> np.ndarray:
    """Return the positions (N, 3) of the starts, step 1, or ends, step 2, of halfedges (N,)."""
    return state.mesh.vertices[state.mesh.triangles[halfedges // 3, (halfedges % 3 + step) % 3]]


def _split(state: LevelState, found: SplitEdges, points: np.ndarray, uvs: np.ndarray, others: np.ndarray) -> LevelState:
    """Return the level with the edges `found` (K,) split at `points` (K, 3), whose texture coordinates are `uvs` (K, 2) at the first
    halfedge and `others` (K, 2) at the second one of a seam."""
    mesh, count = state.mesh, len(found.first)
    if not count:
        return state
    own = np.flatnonzero((found.second >= 0) & found.is_border)  # rows with a second wedge
    paired = np.flatnonzero(found.second >= 0)
    vertices = (len(mesh.vertices) + np.arange(count)).astype(np.int32)
    first_wedges = (len(mesh.uvs) + np.arange(count)).astype(np.int32)
    second_wedges = first_wedges.copy()
    second_wedges[own] = len(mesh.uvs) + count + np.arange(len(own))
    sides = np.concatenate([found.first, found.second[paired]])
    new_vertices = np.concatenate([vertices, vertices[paired]])
    new_wedges = np.concatenate([first_wedges, second_wedges[paired]])
    faces, corners, rows = sides // 3, sides % 3, np.arange(len(sides))
    changed = {}
    for name, old, added in (("triangles", mesh.triangles, new_vertices), ("wedge_triangles", mesh.wedge_triangles, new_wedges)):
        near, far = old[faces].copy(), old[faces].copy()
        near[rows, (corners + 2) % 3], far[rows, (corners + 1) % 3] = added, added
        result = old.copy()
        result[faces] = near
        changed[name] = np.concatenate([result, far])
    halfedges = np.concatenate([found.first, found.second[own]])
    starts, ends = (_wedges(state, halfedges, step) for step in (1, 2))
    split = replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, points]),
        wedge_vertices=np.concatenate([mesh.wedge_vertices, vertices, vertices[own]]),
        uvs=np.concatenate([mesh.uvs, uvs, others[own]]),
        attributes=np.concatenate([mesh.attributes, 0.5 * (mesh.attributes[starts] + mesh.attributes[ends])]),
        materials=np.concatenate([mesh.materials, mesh.materials[faces]]),
        sources=np.concatenate([mesh.sources, mesh.sources[faces]]),
        **changed,
    )
    return attach(split, np.concatenate([state.islands, state.islands[faces]]), state.samples, state.normal_weight, state.found.triangles)
