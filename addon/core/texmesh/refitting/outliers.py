"""Outliers: the places of a level that are much farther from the fine mesh than most, by the true distance from both sides.

Least squares between equal texture coordinates leave them where few samples lie: at edges that bridge a valley, beside small triangles, and
beyond concave boundaries, where the fine mesh has no texture coordinates. The mean hardly shows them; renders do.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...geometry.distance import TriangleTree, closest_barycentric
from ...geometry.edges import Edges
from ...geometry.mesh import face_areas_and_normals
from .correspondence import Correspondence
from .edge_flips import find_quads, flip_quads, select_flips
from .least_squares import Linearization, compute_moments
from .level_state import LevelState
from .sampling import SurfaceSamples
from .spikes import FineSurface, avoid_folds

LIMIT_FACTOR = 5.0  # of the root mean squared distance: points that are farther are outliers
EDGE_FRACTIONS = np.array([0.25, 0.5, 0.75])  # along an edge, where its distance is measured
ATTRACTION = 0.5  # weight of an outlier at the limit, relative to all samples of a triangle
MAX_ATTRACTION = 30.0
ATTRACTED_FRACTION = 0.9  # of the limit, from which on points are attracted, so that they do not become outliers
MAX_FLIPPED_FRACTION = 0.7  # of the distance of an edge that the flipped edge has at most
MAX_WITHDRAWALS = 4


@dataclass(frozen=True)
class LevelDistances:
    """How far a level is from the fine mesh.

    edges: its E edges. at_vertices: (V,) distances of its vertices, at_edges: (E, 3) those of the points EDGE_FRACTIONS of its edges,
    from the lower vertex to the other one; at other points at most as far as the limit, upper bounds may stand for them.
    triangles, barycentric, targets: K points of the level, and the points of the fine mesh (K, 3) that they should be nearer to: the
    nearest ones of distant points of the level, and distant points of the fine mesh. distances: (K,) between them. limit: the distance
    above which points are outliers.
    """

    edges: Edges
    at_vertices: np.ndarray
    at_edges: np.ndarray
    triangles: np.ndarray
    barycentric: np.ndarray
    targets: np.ndarray
    distances: np.ndarray
    limit: float

    @property
    def edge_peaks(self) -> np.ndarray:
        """(E,) largest distances of edges, and of distant points of the fine mesh, which count for the longest edge of their triangle."""
        return self.at_edges.max(axis=1)


def measure_distances(state: LevelState, surface: FineSurface) -> LevelDistances:
    """Measure a level from both sides."""
    mesh, edges = state.mesh, state.find_edges()
    points = np.concatenate([mesh.vertices, _edge_points(mesh.vertices, edges).reshape(-1, 3)])
    distances, nearest = surface.find_closest(points)
    count = len(mesh.vertices)
    limit = LIMIT_FACTOR * _rms_distance(state)
    far = np.flatnonzero(distances > ATTRACTED_FRACTION * limit)
    triangles, barycentric = _locate(state, edges, far)
    fine_corners = surface.mesh.vertices[surface.mesh.triangles[nearest[far]]]
    targets = np.einsum("ni,nic->nc", closest_barycentric(points[far], fine_corners), fine_corners)
    missed = np.flatnonzero(np.einsum("ni,ni->n", state.residuals, state.residuals) > (ATTRACTED_FRACTION * limit) ** 2)
    fine_points = state.samples.positions[missed]
    fine_distances, fine_nearest = TriangleTree(state.corners).find_closest(fine_points)
    is_far = fine_distances > ATTRACTED_FRACTION * limit
    fine_points, fine_nearest, fine_distances = fine_points[is_far], fine_nearest[is_far], fine_distances[is_far]
    return LevelDistances(
        edges=edges,
        at_vertices=distances[:count],
        at_edges=distances[count:].reshape(-1, len(EDGE_FRACTIONS)),
        triangles=np.concatenate([triangles, fine_nearest]),
        barycentric=np.concatenate([barycentric, closest_barycentric(fine_points, state.corners[fine_nearest])]),
        targets=np.concatenate([targets, fine_points]),
        distances=np.concatenate([distances[far], fine_distances]),
        limit=limit,
    )


def flip_outliers(state: LevelState, surface: FineSurface, measured: LevelDistances) -> LevelState:
    """Return the level with outlying edges flipped where the flipped edge is much nearer to the fine mesh."""
    quads = find_quads(state)
    if not len(quads.triangles):
        return state
    peaks = measured.at_edges.max(axis=1)[measured.edges.between(quads.vertices[:, 1], quads.vertices[:, 3])]
    far = np.flatnonzero(peaks > measured.limit)
    first, second = (state.mesh.vertices[quads.vertices[far, corner]] for corner in (0, 2))
    points = first[:, None] + EDGE_FRACTIONS[:, None] * (second - first)[:, None]
    after = surface.measure_distances(points.reshape(-1, 3)).reshape(-1, len(EDGE_FRACTIONS)).max(axis=1)
    gains = np.zeros(len(peaks))
    gains[far] = np.where(after < MAX_FLIPPED_FRACTION * peaks[far], peaks[far] - after, 0.0)
    return flip_quads(state, quads, select_flips(state, quads, gains))


def approach(state: LevelState, surface: FineSurface, measured: LevelDistances, uv_scale: float) -> LevelState:
    """Return the level after a step of positions in which outliers count more. No vertex moves that would make an outlier.

    measured: of `state`. uv_scale: length of a unit of UV space on the surface.
    """
    if not len(measured.distances):
        return state
    attracted = _attract(state, measured)
    step = Linearization(attracted, compute_moments(attracted), None, 0.0).solve(uv_scale)
    vertices = avoid_folds(state, state.mesh.vertices + step)
    return state.move(_withdraw(state, vertices, surface, measured))


def _attract(state: LevelState, measured: LevelDistances) -> LevelState:
    """Return the level with samples added that attract the outliers."""
    count = len(measured.distances)
    areas, _ = face_areas_and_normals(state.corners)
    size = np.maximum(areas[measured.triangles], areas.mean())
    weights = size * np.minimum(ATTRACTION * (measured.distances / measured.limit) ** 4, MAX_ATTRACTION)
    samples, found = state.samples, state.found
    blank = np.zeros(count)
    added = (blank, measured.barycentric, measured.targets, np.zeros((count, 2)), blank, weights)
    values = (samples.triangles, samples.barycentric, samples.positions, samples.uvs, samples.islands, samples.weights)
    joined = SurfaceSamples(*(np.concatenate([value, extra]) for value, extra in zip(values, added, strict=True)))
    return LevelState(
        state.mesh,
        state.islands,
        joined,
        Correspondence(
            np.concatenate([found.triangles, measured.triangles]),
            np.concatenate([found.barycentric, measured.barycentric]),
            np.concatenate([found.is_covered, np.ones(count, bool)]),
        ),
        state.normal_weight,
    )


def _withdraw(state: LevelState, vertices: np.ndarray, surface: FineSurface, measured: LevelDistances) -> np.ndarray:
    """Return `vertices` (V, 3), but those stay where they are in `state` that would make an outlier, or make one worse."""
    ends, result = measured.edges.ends, vertices.copy()
    before = np.concatenate([measured.at_vertices, measured.at_edges.ravel()])
    allowed = np.maximum(before, measured.limit)
    for _ in range(MAX_WITHDRAWALS):
        moves = np.linalg.norm(result - state.mesh.vertices, axis=1)
        bounds = before + np.concatenate([moves, np.repeat(moves[ends].max(axis=1), len(EDGE_FRACTIONS))])
        rows = np.flatnonzero((bounds > allowed) & (bounds > before))
        points = np.concatenate([result, _edge_points(result, measured.edges).reshape(-1, 3)])[rows]
        worse = rows[surface.measure_distances(points) > allowed[rows]]
        is_vertex = worse < len(vertices)
        stays = np.concatenate([worse[is_vertex], ends[(worse[~is_vertex] - len(vertices)) // len(EDGE_FRACTIONS)].ravel()])
        if not len(stays):
            break
        result[stays] = state.mesh.vertices[stays]
    return result


def _edge_points(vertices: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the points (E, 3, 3) of edges at EDGE_FRACTIONS."""
    first, second = vertices[edges.ends[:, 0]], vertices[edges.ends[:, 1]]
    return first[:, None] + EDGE_FRACTIONS[:, None] * (second - first)[:, None]


def _locate(state: LevelState, edges: Edges, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (N,) and barycentric coordinates (N, 3) of the measured points `rows` (N,): vertices, then points of edges."""
    mesh = state.mesh
    corners = np.zeros(len(mesh.vertices), np.int64)
    corners[mesh.triangles.ravel()] = np.arange(mesh.triangles.size)
    halfedges = np.zeros(len(edges.ends), np.int64)
    halfedges[edges.face_edges.ravel()] = np.arange(edges.face_edges.size)
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


def _rms_distance(state: LevelState) -> float:
    """Return the root mean squared distance of the samples from the planes of their triangles, by area."""
    _, normals = face_areas_and_normals(state.corners)
    along = np.einsum("ni,ni->n", state.residuals, normals[state.found.triangles])
    return float(np.sqrt(np.average(along**2, weights=state.samples.weights)))
