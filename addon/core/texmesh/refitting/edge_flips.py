"""Edge flips of a level that lower its deviation."""

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import TINY, concatenate_ranges
from ...geometry.mesh import face_areas_and_normals
from ...geometry.proximity import counting_argsort
from ...geometry.transforms import cross, signed_areas
from .correspondence import evaluate_uv_maps, invert_uv_maps
from .level_state import LevelState

NEW_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])  # corners of a quad after the flip
MIN_UV_FRACTION = 0.02  # area of a new triangle in UV space relative to its quadrilateral
MIN_NORMAL_COSINE = 0.2  # between a new triangle and the mean of the old ones
MIN_GAIN = 1e-3  # A flip lowers the cost of the two triangles by at least this fraction.


def flip_edges(state: LevelState, max_rounds: int) -> LevelState:
    """Return the level after rounds of flips of edges that do not touch each other, each of which lowers the cost of its samples.

    Seams, boundaries and edges between materials are kept. No triangle is flipped in UV space.
    """
    for _ in range(max_rounds):
        quads = find_quads(state)
        if not len(quads.triangles):
            break
        gains, costs = _compute_gains(state, quads)
        rows = select_flips(state, quads, np.where(gains > MIN_GAIN * costs, gains, 0.0))
        if not len(rows):
            break
        state = flip_quads(state, quads, rows)
    return state


@dataclass(frozen=True)
class Quads:
    """Pairs of triangles whose common edge may be flipped.

    Attributes:
        triangles: (K, 2).
        corners: (K, 4) of the level, counterclockwise; the edge joins 1 and 3, the flipped one 0 and 2.
        vertices, wedges: (K, 4), of these corners.
        normals: (K, 3), means of both triangles.
    """

    triangles: np.ndarray
    corners: np.ndarray
    vertices: np.ndarray
    wedges: np.ndarray
    normals: np.ndarray


def find_quads(state: LevelState, is_wanted: np.ndarray | None = None) -> Quads:
    """Return the pairs of triangles whose edge can be flipped: no seam, and without a fold in space or UV.

    is_wanted: (E,) bool, edges of which others are left out; None for all.
    """
    mesh, edges = state.mesh, state.edges
    is_open = ~mesh.find_seams(edges)
    if is_wanted is not None:
        is_open &= is_wanted
    first, second = edges.interior_halfedges[is_open[edges.interior]].T
    t, c, s, d = first // 3, first % 3, second // 3, second % 3
    is_open = (mesh.materials[t] == mesh.materials[s]) & (state.islands[t] == state.islands[s])
    t, c, s, d = t[is_open], c[is_open], s[is_open], d[is_open]
    corners = np.stack([3 * t + c, 3 * t + (c + 1) % 3, 3 * s + d, 3 * t + (c + 2) % 3], axis=1)
    vertices, wedges = mesh.triangles.ravel()[corners], mesh.wedge_triangles.ravel()[corners]
    is_valid = edges.between(vertices[:, 0], vertices[:, 2]) < 0
    is_valid &= (mesh.triangles[s, (d + 1) % 3] == vertices[:, 3]) & (vertices[:, 0] != vertices[:, 2])
    uvs, points = mesh.uvs[wedges], mesh.vertices[vertices]
    areas = signed_areas(uvs[:, NEW_TRIANGLES])
    old = signed_areas(uvs[:, [[0, 1, 3], [2, 3, 1]]])
    sign = np.sign(old.sum(axis=1))
    is_valid &= (areas * sign[:, None] > MIN_UV_FRACTION * np.abs(old.sum(axis=1))[:, None]).all(axis=1) | (sign == 0.0)
    _, normals = state.areas_and_normals
    mean = normals[t] + normals[s]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), TINY)
    for triangle in NEW_TRIANGLES:
        _, normal = face_areas_and_normals(points[:, triangle])
        is_valid &= np.einsum("ni,ni->n", normal, mean) > MIN_NORMAL_COSINE
    chosen = np.flatnonzero(is_valid)
    return Quads(np.stack([t, s], axis=1)[chosen], corners[chosen], vertices[chosen], wedges[chosen], mean[chosen])


def select_flips(state: LevelState, quads: Quads, gains: np.ndarray) -> np.ndarray:
    """Return the indices of quads with positive `gains` (K,) that share no triangle, and whose flips add no edge twice."""
    rows = select_largest(gains, quads.triangles, len(state.mesh.triangles))
    diagonals = np.sort(quads.vertices[rows][:, [0, 2]], axis=1)
    return rows[np.unique(diagonals, axis=0, return_index=True)[1]]


def flip_quads(state: LevelState, quads: Quads, rows: np.ndarray) -> LevelState:
    """Return the level with the edges of the quads `rows` (R,) flipped."""
    if not len(rows):
        return state
    mesh = state.mesh
    triangles, wedge_triangles, sources = mesh.triangles.copy(), mesh.wedge_triangles.copy(), mesh.sources.copy()
    pairs = quads.triangles[rows]
    triangles[pairs] = quads.vertices[rows][:, NEW_TRIANGLES]
    wedge_triangles[pairs] = quads.wedges[rows][:, NEW_TRIANGLES]
    sources[pairs] = mesh.sources.ravel()[quads.corners[rows]][:, NEW_TRIANGLES]
    flipped = replace(mesh, triangles=triangles, wedge_triangles=wedge_triangles, sources=sources)
    return state.replace_triangles(flipped, pairs)


def select_largest(gains: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of items with positive `gains` (K,) that share none of their `triangles` (K, C) of `count`, large gains first."""
    rows = np.flatnonzero(gains > 0.0)
    ranks = np.argsort(np.argsort(-gains[rows], kind="stable"), kind="stable")
    best = np.full(count, len(rows), np.int64)
    np.minimum.at(best, triangles[rows].ravel(), np.repeat(ranks, triangles.shape[1]))
    return rows[(best[triangles[rows]] == ranks[:, None]).all(axis=1)]


def _compute_gains(state: LevelState, quads: Quads) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much the flip of each quad lowers the cost (K,), and its present cost (K,)."""
    first, second = quads.triangles.T
    count = len(state.islands)
    costs = np.bincount(state.found.triangles, state.costs, count)
    order = counting_argsort(state.found.triangles, count)
    sizes = np.bincount(state.found.triangles, minlength=count)
    starts = np.cumsum(sizes) - sizes
    axes = _find_tangents(quads.normals)
    points = state.mesh.vertices[quads.vertices]
    flat_quads, uv_quads = np.einsum("kci,kai->kca", points, axes), state.mesh.uvs[quads.wedges]
    total = np.zeros(len(first))
    for triangle in (first, second):
        quad = np.repeat(np.arange(len(first)), sizes[triangle])
        sample = order[concatenate_ranges(starts[triangle], sizes[triangle])]
        is_spatial = state.found.is_spatial[sample]
        rows, samples = quad[~is_spatial], sample[~is_spatial]
        total += _sum_costs(state, quads, uv_quads, rows, samples, state.samples.uvs.take(samples, axis=0))
        rows, samples = quad[is_spatial], sample[is_spatial]
        if len(rows):
            places = np.einsum("ni,nai->na", state.samples.positions[samples], axes[rows])
            total += _sum_costs(state, quads, flat_quads, rows, samples, places)
    present = costs[first] + costs[second]
    return present - total, present


def _sum_costs(
    state: LevelState, quads: Quads, corners: np.ndarray, rows: np.ndarray, samples: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Return the costs (K,) of pairs of one of the quads `rows` (N,) and one of `samples` (N,) after the flips.

    corners: (K, 4, 2) of the quads in a plane: UV space, or their own. places: (N, 2) of the samples there.
    """
    new_triangles = corners[:, NEW_TRIANGLES].reshape(-1, 3, 2)
    maps, points = invert_uv_maps(new_triangles), state.mesh.vertices[quads.vertices][:, NEW_TRIANGLES].reshape(-1, 3, 3)
    diagonal = corners[:, 2] - corners[:, 0]
    side = np.sign(signed_areas(corners[:, [0, 1, 2]]))
    offset = cross(diagonal, corners[:, 0])
    u, v = places.T
    across = diagonal[:, 0].take(rows) * v - diagonal[:, 1].take(rows) * u - offset.take(rows)
    triangles = 2 * rows + (across * side.take(rows) > 0.0)
    weights = evaluate_uv_maps(maps, triangles, u, v)
    np.maximum(weights, 0.0, out=weights)  # for samples that the level does not cover
    weights /= np.maximum(weights.sum(axis=0), TINY)
    squares, along = np.zeros(len(rows)), np.zeros(len(rows))
    for axis in range(3):
        residual = -state.samples.positions[:, axis].take(samples)
        for corner in range(3):
            residual += weights[corner] * points[:, corner, axis].take(triangles)
        squares += residual**2
        along += residual * quads.normals[:, axis].take(rows)
    costs = state.samples.weights.take(samples) * (squares + (state.normal_weight - 1.0) * along**2)
    return np.bincount(rows, costs, len(corners))


def _find_tangents(normals: np.ndarray) -> np.ndarray:
    """Return two unit vectors (K, 2, 3) that are perpendicular to each of unit `normals` (K, 3) and to each other."""
    helpers = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, helpers)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), TINY)
    return np.stack([first, np.cross(normals, first)], axis=1)
