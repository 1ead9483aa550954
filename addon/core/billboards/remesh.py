"""Edge collapses and flips of a coarse mesh, each judged by the distance of the fine samples around it.

All edges are judged at once; then those are done that help most, as long as no two touch the same triangle. So what was judged is what
comes out: samples that were closest to the replaced triangles are no farther from the new ones than was found.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..distance import closest_on_mesh, closest_points, first_least, point_triangle_distances
from ..edges import Edges, edges_of
from ..mesh import face_areas_and_normals

LEAST_TURN = 0.2  # cosine: a triangle that turns farther by a collapse has folded over
CHUNK_TESTS = 20_000  # of a sample against a triangle: what stays in a core's cache
PLACING_POWERS = (2.0, 4.0)
PLACING_DAMPING = 1e-3  # of the trace


@dataclass(frozen=True)
class Collapses:
    """Every edge of a mesh that may be collapsed, judged.

    edges (E, 2) int; targets (E, 3) where the joined vertex goes; costs (E,) the largest distance of a sample around to the triangles that
    are left, infinite where one of them would fold over. around, touched: pairs of an edge, ascending, and a triangle at one of its ends.
    """

    edges: np.ndarray
    targets: np.ndarray
    costs: np.ndarray
    around: np.ndarray
    touched: np.ndarray

    def carry_out(
        self, vertices: np.ndarray, triangles: np.ndarray, limit: float, most: int, skipped: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """The mesh after up to `most` collapses that cost `limit` at most, the cheapest first but for `skipped`, none beside another."""
        costs = self.costs.copy()
        costs[np.argsort(costs, kind="stable")[:skipped]] = np.inf
        chosen = _independent(costs, costs <= limit, self.around, self.touched, len(triangles), most)
        moved, merged = vertices.copy(), np.arange(len(vertices))
        moved[self.edges[chosen, 0]] = self.targets[chosen]
        merged[self.edges[chosen, 1]] = self.edges[chosen, 0]
        return compact(moved, merged[triangles])


def judge_collapses(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> Collapses:
    """Look for the best place of the vertex that each edge would be collapsed to, by the samples around.

    Args:
        samples: (S, 3) float64 points of the fine surface.
        vertices, triangles: (V, 3) float64 and (T, 3) int, the coarse mesh.
    """
    of_mesh = edges_of(triangles, len(vertices))
    edges = of_mesh.ends[_keeps_topology(of_mesh)]
    around, touched = _stars(edges, triangles, len(vertices))
    first = triangles[touched] == edges[around, :1]
    second = triangles[touched] == edges[around, 1:]
    kept = ~(first.any(axis=1) & second.any(axis=1))
    star = _Star(around, touched, kept, first | second)
    border = of_mesh.on_border[edges].any(axis=1)
    samples_of = _samples_of_triangles(samples, vertices[triangles])
    costs, targets = np.full(len(edges), np.inf), vertices[edges].mean(axis=1)
    # From the middle, moves find the best place but for the corners of a border, which only an end of the edge keeps.
    at_border = np.flatnonzero(border)
    for share, judged, powers in ((0.5, np.arange(len(edges)), PLACING_POWERS), (0.0, at_border, ()), (1.0, at_border, ())):
        for tests in _tests(samples_of, star, judged):
            first_end, second_end = vertices[edges[tests.rows].T]
            position = (1.0 - share) * first_end + share * second_end
            for power in (*powers, None):
                cost, move = _place(tests, star, samples, vertices[triangles], position, power)
                better = cost < costs[tests.rows]
                costs[tests.rows[better]], targets[tests.rows[better]] = cost[better], position[better]
                position = position + move
    return Collapses(edges, targets, costs, around, touched)


def flip(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, least_gain: float) -> np.ndarray:
    """Triangles (T, 3) after flipping the edges between two triangles where that lowers the largest distance of the samples around.

    `samples` (S, 3), `vertices` (V, 3); `least_gain` is a length: a flip that gains less is not worth it.
    """
    edges = edges_of(triangles, len(vertices))
    sides = edges.inner_sides
    tips = triangles[sides // 3, sides % 3]
    ends = triangles[sides[:, 0] // 3, (sides[:, 0] % 3 + 1) % 3], triangles[sides[:, 0] // 3, (sides[:, 0] % 3 + 2) % 3]
    fresh = (tips[:, 0] != tips[:, 1]) & (edges.between(*tips.T) < 0)
    sides, tips, ends = sides[fresh], tips[fresh], (ends[0][fresh], ends[1][fresh])
    pairs = np.stack([np.stack([tips[:, 0], ends[0], tips[:, 1]], axis=1), np.stack([tips[:, 0], tips[:, 1], ends[1]], axis=1)], axis=1)
    around, triangle = np.repeat(np.arange(len(sides)), 2), (sides // 3).ravel()
    samples_of = _samples_of_triangles(samples, vertices[triangles])
    old, new = vertices[triangles[triangle]], vertices[pairs.reshape(-1, 3)]
    folded = np.zeros(len(sides), bool)
    both = face_areas_and_normals(old)[1].reshape(-1, 2, 3).sum(axis=1)
    folded[around[np.einsum("ij,ij->i", face_areas_and_normals(new)[1], both[around]) < LEAST_TURN]] = True
    judged = np.flatnonzero(~folded)
    star = _Star(around, triangle, np.ones(len(around), bool), None)
    gain = np.full(len(sides), -np.inf)
    for tests in _tests(samples_of, star, judged):
        points = samples[tests.sample]
        before, after = (tests.largest(point_triangle_distances(points, corners[tests.pair])) for corners in (old, new))
        gain[tests.rows] = before - after
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


def _keeps_topology(edges: Edges) -> np.ndarray:
    """(E,) bool: the ends share no neighbour but the tips of the edge's own triangles (the link condition), and no border is pinched."""
    ends, shared = edges.ends, edges.uses
    ones = np.ones(2 * len(ends), np.int32)
    links = csr_matrix((ones, (ends.ravel(), ends[:, ::-1].ravel())), shape=(edges.count, edges.count))
    common = np.asarray(links[ends[:, 0]].multiply(links[ends[:, 1]]).sum(axis=1)).ravel()
    return (common == shared) & (shared <= 2) & ((shared == 1) | ~edges.on_border[ends].all(axis=1))


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


@dataclass(frozen=True)
class _Star:
    """Pairs (P,) of a candidate, ascending in `around`, and a triangle `touched` by it; which are `kept`; which corners (P, 3) it moves."""

    around: np.ndarray
    touched: np.ndarray
    kept: np.ndarray
    moved: np.ndarray | None


@dataclass(frozen=True)
class _Tests:
    """Each sample around the candidates `rows` (R,) against each triangle that its candidate keeps.

    sample, pair (N,): one test; the pair is one of a star's. starts (M,): first test of each candidate and sample. row (M,): the place in
    `rows` of that candidate, ascending; no row is without a test.
    """

    rows: np.ndarray
    sample: np.ndarray
    pair: np.ndarray
    starts: np.ndarray
    row: np.ndarray

    def largest(self, squared: np.ndarray) -> np.ndarray:
        """Largest distance (R,) of a sample of each row to its nearest triangle, from the `squared` (N,) distance of each test."""
        nearest = np.minimum.reduceat(squared, self.starts)
        return np.sqrt(np.maximum.reduceat(nearest, np.flatnonzero(np.diff(self.row, prepend=-1))))


def _tests(samples_of: tuple[np.ndarray, np.ndarray], star: _Star, judged: np.ndarray) -> Iterator[_Tests]:
    """The tests of the candidates `judged` (J,), ascending, some at a time; those without samples or kept triangles are left out."""
    starts, order = samples_of
    first, stop = np.searchsorted(star.around, judged), np.searchsorted(star.around, judged, side="right")
    kept_before, kept_pairs = np.append(0, np.cumsum(star.kept)), np.flatnonzero(star.kept)
    samples_before = np.append(0, np.cumsum(np.diff(starts)[star.touched]))
    work = (samples_before[stop] - samples_before[first]) * (kept_before[stop] - kept_before[first])
    chunk = np.cumsum(work) // CHUNK_TESTS
    able = np.flatnonzero(work > 0)
    for chosen in np.split(able, np.flatnonzero(np.diff(chunk[able])) + 1) if len(able) else []:
        row_of_pair, pair = _expand(first[chosen], stop[chosen])
        row_of_sample, place = _expand(starts[star.touched[pair]], starts[star.touched[pair] + 1])
        row = row_of_pair[row_of_sample]
        test, new = _expand(kept_before[first[chosen]][row], kept_before[stop[chosen]][row])
        yield _Tests(judged[chosen], order[place][test], kept_pairs[new], np.flatnonzero(np.diff(test, prepend=-1)), row)


def _place(
    tests: _Tests, star: _Star, samples: np.ndarray, corners: np.ndarray, position: np.ndarray, power: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Costs (R,) with the moved corners at `position` (R, 3), and the moves (R, 3) that lower the sum of distance^power; 0 without one."""
    count = len(tests.rows)
    lowest = tests.pair.min()
    used = np.bincount(tests.pair - lowest) > 0
    pairs, pair_of_test = lowest + np.flatnonzero(used), (np.cumsum(used) - 1)[tests.pair - lowest]
    row_of_pair = np.searchsorted(tests.rows, star.around[pairs])
    old = corners[star.touched[pairs]]
    new = np.where(star.moved[pairs][:, :, None], position[row_of_pair][:, None], old)
    points = samples[tests.sample]
    squared, along_b, along_c = closest_points(points, new[pair_of_test])
    costs = tests.largest(squared)
    costs[row_of_pair[_turns_over(old, new)]] = np.inf
    if power is None:
        return costs, np.zeros((count, 3))
    best = first_least(squared, tests.starts)
    weights = np.stack([1.0 - along_b[best] - along_c[best], along_b[best], along_c[best]], axis=1)
    triangle = pair_of_test[best]
    away = points[best] - np.einsum("nk,nkj->nj", weights, new[triangle])
    distances = np.sqrt(squared[best])
    largest = tests.largest(squared)[tests.row]
    share = (weights * star.moved[pairs][triangle]).sum(axis=1)
    normals = face_areas_and_normals(new)[1][triangle]
    apart = distances > 1e-6 * largest
    along = share[:, None] * np.where(apart[:, None], away / np.where(apart, distances, 1.0)[:, None], normals)
    emphasis = (distances / np.where(largest > 0.0, largest, 1.0)) ** (power - 2.0)
    bins = np.flatnonzero(np.diff(tests.row, prepend=-1))
    matrix = np.add.reduceat(emphasis[:, None, None] * along[:, :, None] * along[:, None, :], bins)
    right = np.add.reduceat((emphasis * distances)[:, None] * along, bins)
    damping = PLACING_DAMPING * np.trace(matrix, axis1=1, axis2=2) + 1e-300
    moves = np.linalg.solve(matrix + damping[:, None, None] * np.eye(3), right[:, :, None])[:, :, 0]
    return costs, moves / (power - 1.0)


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
