"""Edge flips of a level that lower its deviation."""

from dataclasses import replace

import numpy as np

from ...arrays import TINY, concatenate_ranges
from ...geometry.mesh import face_areas_and_normals
from .level_state import LevelState

MIN_UV_FRACTION = 0.02  # area of a new triangle in UV space relative to its quadrilateral
MIN_NORMAL_COSINE = 0.2  # between a new triangle and the mean of the old ones
MIN_GAIN = 1e-3  # of the cost of the two triangles


def flip_edges(state: LevelState, max_rounds: int) -> LevelState:
    """Return the level after rounds of flips of edges that do not touch each other, each of which lowers the cost of its samples.

    Seams, boundaries and edges between materials are kept. No triangle is flipped in UV space.
    """
    for _ in range(max_rounds):
        flipped = _flip_once(state)
        if flipped is None:
            break
        state = flipped
    return state


def _flip_once(state: LevelState) -> LevelState | None:
    mesh = state.mesh
    edges = state.find_edges()
    first, second = edges.interior_halfedges.T
    seams = mesh.find_seams(edges)[edges.interior]
    t, c, s, d = first // 3, first % 3, second // 3, second % 3
    is_open = ~seams & (mesh.materials[t] == mesh.materials[s]) & (state.islands[t] == state.islands[s])
    t, c, s, d = t[is_open], c[is_open], s[is_open], d[is_open]
    corner = np.stack([3 * t + c, 3 * t + (c + 1) % 3, 3 * s + d, 3 * t + (c + 2) % 3], axis=1)  # r, p, s, q: counterclockwise
    vertices, wedges = mesh.triangles.ravel()[corner], mesh.wedge_triangles.ravel()[corner]
    is_valid = edges.between(vertices[:, 0], vertices[:, 2]) < 0
    is_valid &= (mesh.triangles[s, (d + 1) % 3] == vertices[:, 3]) & (vertices[:, 0] != vertices[:, 2])
    uvs, points = mesh.uvs[wedges], mesh.vertices[vertices]
    new = np.array([[0, 1, 2], [0, 2, 3]])
    areas = _cross(uvs[:, new])
    old = _cross(uvs[:, [[0, 1, 3], [2, 3, 1]]])
    sign = np.sign(old.sum(axis=1))
    is_valid &= (areas * sign[:, None] > MIN_UV_FRACTION * np.abs(old.sum(axis=1))[:, None]).all(axis=1)
    _, normals = face_areas_and_normals(state.corners)
    mean = normals[t] + normals[s]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), TINY)
    for triangle in new:
        _, normal = face_areas_and_normals(points[:, triangle])
        is_valid &= np.einsum("ni,ni->n", normal, mean) > MIN_NORMAL_COSINE
    chosen = np.flatnonzero(is_valid)
    if not len(chosen):
        return None
    gains, costs = _compute_gains(state, t[chosen], s[chosen], uvs[chosen], points[chosen], mean[chosen])
    gains = np.where(gains > MIN_GAIN * costs, gains, 0.0)
    taken = chosen[select_independent(gains, np.stack([t, s], axis=1)[chosen], len(mesh.triangles))]
    if not len(taken):
        return None
    triangles, wedge_triangles, sources = mesh.triangles.copy(), mesh.wedge_triangles.copy(), mesh.sources.copy()
    rows = np.stack([t[taken], s[taken]], axis=1)
    triangles[rows] = vertices[taken][:, new]
    wedge_triangles[rows] = wedges[taken][:, new]
    sources[rows] = mesh.sources.ravel()[corner[taken]][:, new]
    flipped = replace(mesh, triangles=triangles, wedge_triangles=wedge_triangles, sources=sources)
    return state.replace_triangles(flipped, rows)


def select_independent(gains: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of items with positive `gains` (K,), each larger than those of all others that use one of its `triangles`
    (K, C) of `count`."""
    order = np.argsort(gains, kind="stable")
    rank = np.empty(len(gains), np.int64)
    rank[order] = np.arange(len(gains))
    best = np.full(count, -1, np.int64)
    np.maximum.at(best, triangles.ravel(), np.repeat(rank, triangles.shape[1]))
    return np.flatnonzero((best[triangles] == rank[:, None]).all(axis=1) & (gains > 0.0))


def _compute_gains(
    state: LevelState, first: np.ndarray, second: np.ndarray, uvs: np.ndarray, points: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much the flip of each quadrilateral lowers the cost (K,), and its present cost (K,).

    first, second: (K,) triangles. uvs: (K, 4, 2), points: (K, 4, 3), of the corners; the new edge joins 0 and 2. normals: (K, 3).
    """
    count = len(state.islands)
    costs = np.bincount(state.found.triangles, state.compute_costs(), count)
    order = np.argsort(state.found.triangles, kind="stable")
    sizes = np.bincount(state.found.triangles, minlength=count)
    starts = np.cumsum(sizes) - sizes
    total = np.zeros(len(first))
    for triangle in (first, second):
        quad = np.repeat(np.arange(len(first)), sizes[triangle])
        sample = order[concatenate_ranges(starts[triangle], sizes[triangle])]
        u = uvs[quad] - state.samples.uvs[sample, None]
        diagonal = _wedge(u[:, 0], u[:, 2])
        quad_sign = np.sign(_cross(uvs[:, None, [0, 1, 2]])[:, 0])[quad]
        is_second = diagonal * quad_sign > 0.0
        rows = np.arange(len(quad))
        corners = np.where(is_second[:, None], [0, 2, 3], [0, 1, 2])
        v = u[rows[:, None], corners]
        weights = np.stack([_wedge(v[:, 1], v[:, 2]), _wedge(v[:, 2], v[:, 0]), _wedge(v[:, 0], v[:, 1])], axis=1)
        weights = np.maximum(weights * quad_sign[:, None], 0.0)  # clamped for samples that the level does not cover
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), TINY)
        residuals = np.einsum("ni,nic->nc", weights, points[quad[:, None], corners]) - state.samples.positions[sample]
        along = np.einsum("ni,ni->n", residuals, normals[quad])
        cost = state.samples.weights[sample] * ((residuals**2).sum(axis=1) + (state.normal_weight - 1.0) * along**2)
        total += np.bincount(quad, cost, len(first))
    present = costs[first] + costs[second]
    return present - total, present


def _cross(corner_uvs: np.ndarray) -> np.ndarray:
    return _wedge(corner_uvs[..., 1, :] - corner_uvs[..., 0, :], corner_uvs[..., 2, :] - corner_uvs[..., 0, :])


def _wedge(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
