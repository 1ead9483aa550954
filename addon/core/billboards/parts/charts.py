"""Charts: parts of a mesh that are height fields over a plane, few of them, so that an orthographic picture textures each."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...geometry.edges import find_edges
from ...geometry.mesh import face_areas_and_normals, vertex_normals
from ...geometry.transforms import frame_from_normal, normalize
from ..cloud import Chart
from ..clustering.rectangles import fit_rectangle, rectangle_area
from .part_meshes import PartMesh

GROWTH_COSINE = float(np.cos(np.radians(50.0)))  # Between a triangle and the axis of the chart that takes it.
MIN_COSINE = 0.5  # Between a triangle and the axis of its finished chart: texels are at most twice as long on it.
MAX_WASTE = 3.0  # Area of the rectangle of a chart over that of its projection; a single triangle has 2.
INSIDE_TOLERANCE = 1e-3  # In barycentric coordinates: neighbors share edges, which are not inside.
SAMPLE_WEIGHTS = np.array(
    [[1.0, 1.0, 1.0], [8.0, 1.0, 1.0], [1.0, 8.0, 1.0], [1.0, 1.0, 8.0], [5.0, 5.0, 1.0], [1.0, 5.0, 5.0], [5.0, 1.0, 5.0]]
)
SAMPLE_WEIGHTS /= SAMPLE_WEIGHTS.sum(axis=1, keepdims=True)
MAX_TESTS = 2_000_000  # Tests of a point in a triangle at once.


@dataclass(frozen=True)
class PlacedChart:
    """A chart with its place.

    Attributes:
        chart: The chart.
        members: (T,) its triangles in the mesh.
        normal: (3,) unit axis of the projection.
        axes: (2, 3) unit u and v.
        rectangle: (4,) bounds along these.
    """

    chart: Chart
    members: np.ndarray
    normal: np.ndarray
    axes: np.ndarray
    rectangle: np.ndarray


def divide_into_charts(mesh: PartMesh) -> list[PlacedChart]:
    """Divide `mesh`, whose triangles all have an area, into charts."""
    corners = mesh.vertices[mesh.triangles]
    areas, normals = face_areas_and_normals(corners)
    pairs = find_edges(mesh.triangles).interior_halfedges // 3
    adjacency = _list_neighbors(pairs, len(areas))
    pending = _grow(areas, normals, adjacency)
    placed = []
    while pending:
        members = pending.pop()
        found = _place(corners[members], areas[members], normals[members])
        if found is None:
            pending += _bisect(members, corners, pairs)
            continue
        used, triangles = np.unique(mesh.triangles[members], return_inverse=True)
        triangles = triangles.reshape(-1, 3).astype(np.int32)
        shading = _shading_normals(mesh.vertices[used], triangles, used, mesh.triangles, normals * areas[:, None])
        chart = Chart(mesh.vertices[used], triangles, shading)
        placed.append(PlacedChart(chart, members, *found))
    return placed


def _shading_normals(
    vertices: np.ndarray, triangles: np.ndarray, used: np.ndarray, mesh_triangles: np.ndarray, scaled: np.ndarray
) -> np.ndarray:
    """Return unit normals (V, 3) of the vertices of a chart, whose indices in the mesh are `used` (V,), ascending.

    They are the means of all triangles of the mesh around them that are not beyond a crease. scaled (T, 3): normals times areas.
    """
    own = vertex_normals(vertices, triangles)
    faces, corners = np.nonzero(np.isin(mesh_triangles, used))
    rows = np.searchsorted(used, mesh_triangles[faces, corners])
    is_smooth = np.einsum("ni,ni->n", own[rows], scaled[faces]) >= GROWTH_COSINE * np.linalg.norm(scaled[faces], axis=1)
    sums = np.zeros_like(own)
    np.add.at(sums, rows[is_smooth], scaled[faces[is_smooth]])
    return normalize(np.where((sums != 0.0).any(axis=1)[:, None], sums, own))


def _list_neighbors(pairs: np.ndarray, count: int) -> list[np.ndarray]:
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    return np.split(both[:, 1], np.searchsorted(both[:, 0], np.arange(1, count)))


def _grow(areas: np.ndarray, normals: np.ndarray, adjacency: list[np.ndarray]) -> list[np.ndarray]:
    """Grow charts from the largest triangles on; each is grown again around the mean normal that it has got."""
    is_free = np.ones(len(areas), bool)
    charts = []
    for seed in np.argsort(-areas, kind="stable"):
        if not is_free[seed]:
            continue
        members = _flood(seed, normals[seed], normals, adjacency, is_free)
        mean = (areas[members, None] * normals[members]).sum(axis=0)
        length = np.linalg.norm(mean)
        if length > 0.0 and normals[seed] @ mean >= GROWTH_COSINE * length:
            members = _flood(seed, mean / length, normals, adjacency, is_free)
        is_free[members] = False
        charts.append(members)
    return charts


def _flood(seed: int, axis: np.ndarray, normals: np.ndarray, adjacency: list[np.ndarray], is_free: np.ndarray) -> np.ndarray:
    """Return the free triangles (N,) connected to `seed` that face `axis`, ascending."""
    seen, front = {int(seed)}, [int(seed)]
    while front:
        for neighbor in adjacency[front.pop()].tolist():
            if neighbor not in seen and is_free[neighbor] and normals[neighbor] @ axis >= GROWTH_COSINE:
                seen.add(neighbor)
                front.append(neighbor)
    return np.sort(np.array(list(seen)))


def _place(corners: np.ndarray, areas: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return axis, axes and rectangle of a chart of triangles `corners` (T, 3, 3); None if it must be divided."""
    mean = (areas[:, None] * normals).sum(axis=0)
    length = np.linalg.norm(mean)
    axis = mean / length if length > 0.0 else normals[0]
    is_single = len(areas) == 1
    if not is_single and (normals @ axis).min() < MIN_COSINE:
        return None
    axes, rectangle = fit_rectangle(corners.reshape(-1, 3), frame_from_normal(axis)[:2])
    if not is_single and (rectangle_area(rectangle) > MAX_WASTE * (areas * (normals @ axis)).sum() or _overlaps(corners @ axes.T)):
        return None
    return axis, axes, rectangle


def _overlaps(triangles: np.ndarray) -> bool:
    """Return whether any of the `triangles` (T, 3, 2), counterclockwise, contains a point of another one."""
    points = np.einsum("sc,tci->tsi", SAMPLE_WEIGHTS, triangles).reshape(-1, 2)
    first, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    doubled = np.maximum(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0], np.finfo(float).tiny)
    step = max(MAX_TESTS // len(triangles), 1)
    for start in range(0, len(points), step):
        offsets = points[start : start + step, None] - first
        b = (offsets[..., 0] * ac[:, 1] - offsets[..., 1] * ac[:, 0]) / doubled
        c = (ab[:, 0] * offsets[..., 1] - ab[:, 1] * offsets[..., 0]) / doubled
        is_inside = (b > INSIDE_TOLERANCE) & (c > INSIDE_TOLERANCE) & (b + c < 1.0 - INSIDE_TOLERANCE)
        if (is_inside.sum(axis=1) > 1).any():
            return True
    return False


def _bisect(members: np.ndarray, corners: np.ndarray, pairs: np.ndarray) -> list[np.ndarray]:
    """Divide the triangles `members` (N,), at least two, across their longest extent; return the connected pieces."""
    centers = corners[members].mean(axis=1)
    centered = centers - centers.mean(axis=0)
    along = centered @ np.linalg.svd(centered, full_matrices=False)[2][0]
    is_upper = np.zeros(len(corners), np.int8)
    is_upper[members] = 1
    is_upper[members[np.argsort(along, kind="stable")[len(members) // 2 :]]] = 2
    linked = pairs[(is_upper[pairs[:, 0]] > 0) & (is_upper[pairs[:, 0]] == is_upper[pairs[:, 1]])]
    rows = np.searchsorted(members, linked)
    graph = coo_array((np.ones(len(rows), bool), (rows[:, 0], rows[:, 1])), shape=(len(members),) * 2)
    labels = connected_components(graph, directed=False)[1]
    return [members[labels == label] for label in range(int(labels.max()) + 1)]
