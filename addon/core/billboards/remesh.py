"""Edge collapses and flips of a coarse mesh, each judged by the distance of the fine samples around it.

All edges are judged at once; then those are done that help most, as long as no two touch the same triangle. So what was judged is what
comes out: samples that were closest to the replaced triangles are no farther from the new ones than was found.
"""

import numpy as np
from scipy.sparse import csr_matrix

from ..distance import closest_on_mesh, point_triangle_distances
from ..mesh import face_areas_and_normals

LEAST_TURN = 0.2  # cosine: a triangle that turns farther by a collapse has folded over
CHUNK_PAIRS = 1_000_000


def unique_edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (E, 2), lower vertex first, and the edge (T, 3) opposite to each corner of every triangle."""
    sides = np.sort(np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1), axis=2).reshape(-1, 2)
    edges, index = np.unique(sides, axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)


def collapse(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, limit: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Collapse up to `most` edges, the least harmful first, where the samples around stay within `limit`.

    Args:
        samples: (S, 3) float64 points of the fine surface.
        vertices, triangles: (V, 3) float64 and (T, 3) int, the coarse mesh.
        limit: largest distance of a sample to the triangles that replace those around a collapsed edge.

    Returns:
        New vertices and triangles; the same number of triangles when nothing could be collapsed.
    """
    edges, _ = unique_edges(triangles)
    edges = edges[_keeps_topology(edges, triangles, len(vertices))]
    around, triangle = _stars(edges, triangles, len(vertices))
    samples_of = _samples_of_triangles(samples, vertices[triangles])
    has_first = (triangles[triangle] == edges[around, :1]).any(axis=1)
    has_second = (triangles[triangle] == edges[around, 1:]).any(axis=1)
    kept = ~(has_first & has_second)
    replaced = (triangles[triangle] == edges[around, :1]) | (triangles[triangle] == edges[around, 1:])
    cost, target = np.full(len(edges), np.inf), np.zeros((len(edges), 3))
    for share in (0.5, 0.0, 1.0):
        positions = (1.0 - share) * vertices[edges[:, 0]] + share * vertices[edges[:, 1]]
        corners = np.where(replaced[:, :, None], positions[around][:, None], vertices[triangles[triangle]])
        folded = np.zeros(len(edges), bool)
        folded[around[kept & _turns_over(vertices[triangles[triangle]], corners)]] = True
        judged = np.flatnonzero(~folded)
        found = np.full(len(edges), np.inf)
        found[judged] = _distances_after(samples, samples_of, judged, around, triangle, kept, corners)
        better = found < cost
        cost[better], target[better] = found[better], positions[better]
    chosen = _independent(cost, cost <= limit, around, triangle, len(triangles), most)
    moved, merged = vertices.copy(), np.arange(len(vertices))
    moved[edges[chosen, 0]] = target[chosen]
    merged[edges[chosen, 1]] = edges[chosen, 0]
    return compact(moved, merged[triangles])


def flip(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, least_gain: float) -> np.ndarray:
    """Triangles (T, 3) after flipping the edges between two triangles where that lowers the largest distance of the samples around.

    `samples` (S, 3), `vertices` (V, 3); `least_gain` is a length: a flip that gains less is not worth it.
    """
    edges, opposite = unique_edges(triangles)
    order = np.argsort(opposite.ravel(), kind="stable")
    counts = np.bincount(opposite.ravel())
    starts = np.cumsum(counts) - counts
    inner = np.flatnonzero(counts == 2)
    sides = np.stack([order[starts[inner]], order[starts[inner] + 1]], axis=1)
    tips = triangles[sides // 3, sides % 3]
    ends = triangles[sides[:, 0] // 3, (sides[:, 0] % 3 + 1) % 3], triangles[sides[:, 0] // 3, (sides[:, 0] % 3 + 2) % 3]
    exists = {(int(a), int(b)) for a, b in edges}
    fresh = np.array([(min(a, b), max(a, b)) not in exists and a != b for a, b in tips.tolist()], bool)
    sides, tips, ends = sides[fresh], tips[fresh], (ends[0][fresh], ends[1][fresh])
    pairs = np.stack([np.stack([tips[:, 0], ends[0], tips[:, 1]], axis=1), np.stack([tips[:, 0], tips[:, 1], ends[1]], axis=1)], axis=1)
    around, triangle = np.repeat(np.arange(len(sides)), 2), (sides // 3).ravel()
    samples_of = _samples_of_triangles(samples, vertices[triangles])
    old, new = vertices[triangles[triangle]], vertices[pairs.reshape(-1, 3)]
    folded = np.zeros(len(sides), bool)
    both = face_areas_and_normals(old)[1].reshape(-1, 2, 3).sum(axis=1)
    folded[around[np.einsum("ij,ij->i", face_areas_and_normals(new)[1], both[around]) < LEAST_TURN]] = True
    judged = np.flatnonzero(~folded)
    everything = np.ones(len(around), bool)
    before = _distances_after(samples, samples_of, judged, around, triangle, everything, old)
    after = np.full(len(sides), np.inf)
    gain = np.full(len(sides), -np.inf)
    after[judged] = _distances_after(samples, samples_of, judged, around, triangle, everything, new)
    gain[judged] = before - after[judged]
    chosen = _independent(-gain, gain > least_gain, around, triangle, len(triangles), len(sides))
    flipped = triangles.copy()
    flipped[sides[chosen] // 3] = pairs[chosen]
    return flipped


def compact(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without triangles that have lost a corner or stand twice, and without unused vertices."""
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    triangles = triangles[np.sort(first)]
    used, index = np.unique(triangles, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int32)


def _keeps_topology(edges: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """(E,) bool: the ends share no neighbour but the tips of the edge's own triangles (the link condition), and no border is pinched."""
    _, opposite = unique_edges(triangles)
    shared = np.bincount(opposite.ravel(), minlength=len(edges))
    ones = np.ones(2 * len(edges), np.int32)
    links = csr_matrix((ones, (edges.ravel(), edges[:, ::-1].ravel())), shape=(count, count))
    common = np.asarray(links[edges[:, 0]].multiply(links[edges[:, 1]]).sum(axis=1)).ravel()
    border = np.zeros(count, bool)
    border[edges[shared == 1]] = True
    return (common == shared) & (shared <= 2) & ((shared == 1) | ~border[edges].all(axis=1))


def _stars(edges: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (edge, triangle), edges ascending, of each edge and every triangle that touches one of its ends."""
    corner = np.arange(triangles.size)
    incidence = csr_matrix((np.ones(triangles.size, np.int8), (triangles.ravel(), corner // 3)), shape=(count, len(triangles)))
    touching = (incidence[edges[:, 0]] + incidence[edges[:, 1]]).tocsr()
    touching.sort_indices()
    return np.repeat(np.arange(len(edges)), np.diff(touching.indptr)), touching.indices.astype(np.int64)


def _samples_of_triangles(samples: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts (T + 1,) and the samples (S,) in between: which samples are nearest to each triangle."""
    _, nearest = closest_on_mesh(samples, corners)
    return np.append(0, np.cumsum(np.bincount(nearest, minlength=len(corners)))), np.argsort(nearest, kind="stable")


def _turns_over(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """(N,) bool: the triangle `new` (N, 3, 3) has no area left or faces away from `old`."""
    return np.einsum("ij,ij->i", face_areas_and_normals(old)[1], face_areas_and_normals(new)[1]) < LEAST_TURN


def _distances_after(samples, samples_of, judged, around, triangle, kept, corners) -> np.ndarray:
    """Largest distance (J,) of the samples of the triangles around each of `judged` to the `kept` ones of the new `corners` (N, 3, 3).

    around, triangle, kept, corners run over pairs of a candidate, ascending, and a triangle around it.
    """
    starts, order = samples_of
    pair_starts = np.searchsorted(around, np.append(judged, judged[-1] + 1 if len(judged) else 0))
    per_pair = np.diff(starts)[triangle]
    new_starts = np.append(0, np.cumsum(kept))
    new_pairs = np.flatnonzero(kept)
    result = np.zeros(len(judged))
    stops = np.searchsorted(around, judged, side="right")
    work = np.array([per_pair[a:b].sum() for a, b in zip(pair_starts[:-1], stops, strict=True)]) * (
        new_starts[stops] - new_starts[pair_starts[:-1]]
    )
    chunk = np.cumsum(work) // CHUNK_PAIRS
    for part in np.unique(chunk):
        rows = np.flatnonzero((chunk == part) & (work > 0))
        if len(rows) == 0:
            continue
        row_of_pair, pair = _expand(pair_starts[rows], stops[rows])
        row_of_sample, place = _expand(starts[triangle[pair]], starts[triangle[pair] + 1])
        row, sample = row_of_pair[row_of_sample], order[place]
        row_of_test, new = _expand(new_starts[pair_starts[rows]][row], new_starts[stops[rows]][row])
        squared = point_triangle_distances(samples[sample[row_of_test]], corners[new_pairs[new]])
        nearest = np.minimum.reduceat(squared, np.flatnonzero(np.diff(row_of_test, prepend=-1)))
        result[rows] = np.sqrt(np.maximum.reduceat(nearest, np.flatnonzero(np.diff(row, prepend=-1))))
    return result


def _expand(starts: np.ndarray, stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All of the ranges starts[i]..stops[i] - 1 one after the other: the i and the values."""
    sizes = stops - starts
    index = np.repeat(np.arange(len(starts)), sizes)
    return index, np.arange(len(index)) - np.repeat(np.cumsum(sizes) - sizes, sizes) + starts[index]


def _independent(cost, allowed, around, triangle, triangle_count: int, most: int) -> np.ndarray:
    """Up to `most` candidates that are allowed, the cheapest first, of which no two touch the same triangle."""
    starts, stops = np.searchsorted(around, np.arange(len(cost))), np.searchsorted(around, np.arange(len(cost)), side="right")
    free = np.ones(triangle_count, bool)
    chosen = []
    for candidate in np.argsort(cost, kind="stable"):
        if not allowed[candidate] or len(chosen) >= most:
            break
        touched = triangle[starts[candidate] : stops[candidate]]
        if free[touched].all():
            free[touched] = False
            chosen.append(int(candidate))
    return np.array(chosen, np.int64)
