"""Edge collapses and flips of a coarse mesh, evaluated by the distance of the fine mesh's samples around them.

All edges are evaluated at once; then the best operations are applied of which no two touch the same triangle. The evaluation thus holds for
the result: samples that were closest to the replaced triangles are no farther from the new ones than was measured.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import TINY, concatenate_ranges
from ...geometry.collapses import satisfies_link_condition, select_disjoint
from ...geometry.distance import closest_on_mesh, closest_on_triangles, segment_argmin, squared_point_triangle_distances
from ...geometry.edges import find_edges
from ...geometry.mesh import face_areas_and_normals

MIN_ROTATION_COSINE = 0.2  # Between the normals of a triangle before and after an operation: below it, it has folded over.
TESTS_PER_CHUNK = 20_000  # Tests of samples against triangles at once: temporary arrays fit into the cache of a CPU core.
PLACEMENT_POWERS = (2.0, 4.0)
PLACEMENT_DAMPING = 1e-3  # Relative to the trace of the normal matrix.
MIN_DIRECTION_DISTANCE = 1e-6  # Relative to the maximum distance. Closer samples use the triangle's normal as their direction.


@dataclass(frozen=True)
class EdgeCollapses:
    """All edges of a mesh that may be collapsed, with their evaluation.

    Attributes:
        edges: (E, 2) int.
        targets: (E, 3) positions of the merged vertices.
        costs: (E,) largest distance of a sample around the edge to the remaining triangles, infinite if one of them would fold over.
        candidates: (N,) edges, ascending, of the pairs of an edge and a triangle at one of its ends.
        touched: (N,) triangles of these pairs.
    """

    edges: np.ndarray
    targets: np.ndarray
    costs: np.ndarray
    candidates: np.ndarray
    touched: np.ndarray

    def apply(
        self, vertices: np.ndarray, triangles: np.ndarray, max_cost: float, max_count: int, skipped: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Collapse up to `max_count` edges with a cost of at most `max_cost`, cheapest first, no two at the same triangle.

        Does not collapse the `skipped` cheapest edges. Returns the new mesh.
        """
        costs = np.where(self.costs <= max_cost, self.costs, np.inf)
        costs[np.argsort(self.costs, kind="stable")[:skipped]] = np.inf
        chosen = select_disjoint(costs, self.candidates, self.touched, len(triangles), max_count)
        moved, merged = vertices.copy(), np.arange(len(vertices))
        moved[self.edges[chosen, 0]] = self.targets[chosen]
        merged[self.edges[chosen, 1]] = self.edges[chosen, 0]
        return remove_degenerate(moved, merged[triangles])


def evaluate_collapses(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> EdgeCollapses:
    """Find the best position of the merged vertex for the collapse of each edge, from the samples around it.

    Args:
        samples: (S, 3) float64 points of the fine surface.
        vertices, triangles: (V, 3) float64 and (T, 3) int, the coarse mesh.
    """
    mesh_edges = find_edges(triangles, len(vertices))
    edges = mesh_edges.ends[satisfies_link_condition(mesh_edges)]
    candidates, touched = _find_stars(edges, triangles, len(vertices))
    has_first = triangles[touched] == edges[candidates, :1]
    has_second = triangles[touched] == edges[candidates, 1:]
    is_kept = ~(has_first.any(axis=1) & has_second.any(axis=1))
    star = _Star(candidates, touched, is_kept, has_first | has_second)
    triangle_samples = _group_samples(samples, vertices[triangles])
    costs, targets = np.full(len(edges), np.inf), vertices[edges].mean(axis=1)
    # Displacements from the midpoint find the best position, except at corners of the boundary, which only an end of the edge preserves.
    boundary_edges = np.flatnonzero(mesh_edges.boundary_vertices[edges].any(axis=1))
    starts = ((0.5, np.arange(len(edges)), PLACEMENT_POWERS), (0.0, boundary_edges, ()), (1.0, boundary_edges, ()))
    for t, evaluated, powers in starts:
        for tests in _generate_tests(triangle_samples, star, evaluated):
            first_end, second_end = vertices[edges[tests.rows].T]
            position = (1.0 - t) * first_end + t * second_end
            for power in (*powers, None):
                cost, displacement = _evaluate_position(tests, star, samples, vertices[triangles], position, power)
                better = cost < costs[tests.rows]
                costs[tests.rows[better]], targets[tests.rows[better]] = cost[better], position[better]
                position = position + displacement
    return EdgeCollapses(edges, targets, costs, candidates, touched)


def flip_edges(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, min_gain: float) -> np.ndarray:
    """Flip the edges between two triangles where this lowers the largest distance of the samples around them.

    Args:
        samples: (S, 3) float64 points of the fine surface.
        vertices, triangles: (V, 3) float64 and (T, 3) int, the coarse mesh.
        min_gain: a length; flips that gain less are not made.

    Returns:
        The new triangles (T, 3).
    """
    edges = find_edges(triangles, len(vertices))
    halfedges = edges.interior_halfedges
    opposite = triangles[halfedges // 3, halfedges % 3]
    face, corner = halfedges[:, 0] // 3, halfedges[:, 0] % 3
    start, end = triangles[face, (corner + 1) % 3], triangles[face, (corner + 2) % 3]
    is_allowed = (opposite[:, 0] != opposite[:, 1]) & (edges.between(*opposite.T) < 0)
    halfedges, opposite, start, end = halfedges[is_allowed], opposite[is_allowed], start[is_allowed], end[is_allowed]
    pairs = np.stack(
        [np.stack([opposite[:, 0], start, opposite[:, 1]], axis=1), np.stack([opposite[:, 0], opposite[:, 1], end], axis=1)], axis=1
    )
    candidates, touched = np.repeat(np.arange(len(halfedges)), 2), (halfedges // 3).ravel()
    triangle_samples = _group_samples(samples, vertices[triangles])
    old, new = vertices[triangles[touched]], vertices[pairs.reshape(-1, 3)]
    is_folded = np.zeros(len(halfedges), bool)
    normal_sums = face_areas_and_normals(old)[1].reshape(-1, 2, 3).sum(axis=1)
    cosines = np.einsum("ij,ij->i", face_areas_and_normals(new)[1], normal_sums[candidates])
    is_folded[candidates[cosines < MIN_ROTATION_COSINE]] = True
    star = _Star(candidates, touched, np.ones(len(candidates), bool), None)
    gains = np.full(len(halfedges), -np.inf)
    for tests in _generate_tests(triangle_samples, star, np.flatnonzero(~is_folded)):
        points = samples[tests.sample]
        before, after = (tests.max_distance(squared_point_triangle_distances(points, corners[tests.pair])) for corners in (old, new))
        gains[tests.rows] = before - after
    costs = np.where(gains > min_gain, -gains, np.inf)
    chosen = select_disjoint(costs, candidates, touched, len(triangles), len(halfedges))
    flipped = triangles.copy()
    flipped[halfedges[chosen] // 3] = pairs[chosen]
    return flipped


def remove_degenerate(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove triangles with repeated vertices, duplicate triangles, and unused vertices."""
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    triangles = triangles[np.sort(first)]
    used, index = np.unique(triangles, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int32)


def _find_stars(edges: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Find all pairs (edge, triangle), edges ascending, of an edge and a triangle at one of its ends."""
    corner = np.arange(triangles.size)
    incidence = csr_matrix((np.ones(triangles.size, np.int8), (triangles.ravel(), corner // 3)), shape=(count, len(triangles)))
    touching = (incidence[edges[:, 0]] + incidence[edges[:, 1]]).tocsr()
    touching.sort_indices()
    return np.repeat(np.arange(len(edges)), np.diff(touching.indptr)), touching.indices.astype(np.int64)


def _group_samples(samples: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group the samples by their nearest triangle: starts (T + 1,) of the groups, and the sample indices (S,) in the order of groups."""
    _, nearest = closest_on_mesh(samples, corners)
    return np.append(0, np.cumsum(np.bincount(nearest, minlength=len(corners)))), np.argsort(nearest, kind="stable")


def _has_folded(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Test whether the triangles `new` (N, 3, 3) have no area or are rotated too far from `old`: (N,) bool."""
    return np.einsum("ij,ij->i", face_areas_and_normals(old)[1], face_areas_and_normals(new)[1]) < MIN_ROTATION_COSINE


@dataclass(frozen=True)
class _Star:
    """P pairs of a candidate operation, ascending, and a triangle that it touches.

    candidates, touched (P,): the pairs. is_kept (P,) bool: the triangle remains. is_moved (P, 3) bool: corners that the operation moves.
    """

    candidates: np.ndarray
    touched: np.ndarray
    is_kept: np.ndarray
    is_moved: np.ndarray | None


@dataclass(frozen=True)
class _Tests:
    """Tests of each sample around some candidates against each triangle that its candidate keeps.

    Attributes:
        rows: (R,) the candidates.
        sample: (N,) sample of each test.
        pair: (N,) pair of a star of each test.
        starts: (M,) first test of each combination of candidate and sample.
        row: (M,) index into `rows` of that candidate, ascending; every row has at least one test.
    """

    rows: np.ndarray
    sample: np.ndarray
    pair: np.ndarray
    starts: np.ndarray
    row: np.ndarray

    def max_distance(self, squared: np.ndarray) -> np.ndarray:
        """Return the largest distance (R,) of a sample of each row to its nearest triangle, from the `squared` (N,) distance per test."""
        nearest = np.minimum.reduceat(squared, self.starts)
        return np.sqrt(np.maximum.reduceat(nearest, np.flatnonzero(np.diff(self.row, prepend=-1))))


def _generate_tests(triangle_samples: tuple[np.ndarray, np.ndarray], star: _Star, evaluated: np.ndarray) -> Iterator[_Tests]:
    """Yield the tests of the candidates `evaluated` (J,), ascending, in chunks, without those that have no samples or kept triangles."""
    starts, order = triangle_samples
    first, stop = np.searchsorted(star.candidates, evaluated), np.searchsorted(star.candidates, evaluated, side="right")
    kept_before, kept_pairs = np.append(0, np.cumsum(star.is_kept)), np.flatnonzero(star.is_kept)
    samples_before = np.append(0, np.cumsum(np.diff(starts)[star.touched]))
    work = (samples_before[stop] - samples_before[first]) * (kept_before[stop] - kept_before[first])
    chunk = np.cumsum(work) // TESTS_PER_CHUNK
    testable = np.flatnonzero(work > 0)
    for chosen in np.split(testable, np.flatnonzero(np.diff(chunk[testable])) + 1) if len(testable) else []:
        row_of_pair, pair = _expand_ranges(first[chosen], stop[chosen])
        row_of_sample, position = _expand_ranges(starts[star.touched[pair]], starts[star.touched[pair] + 1])
        row = row_of_pair[row_of_sample]
        combination, kept = _expand_ranges(kept_before[first[chosen]][row], kept_before[stop[chosen]][row])
        test_starts = np.flatnonzero(np.diff(combination, prepend=-1))
        yield _Tests(evaluated[chosen], order[position][combination], kept_pairs[kept], test_starts, row)


def _evaluate_position(
    tests: _Tests, star: _Star, samples: np.ndarray, corners: np.ndarray, position: np.ndarray, power: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate collapses with the merged vertices at `position` (R, 3).

    Returns:
        The costs (R,), and the displacements (R, 3) of a step that lowers the sum of distance^power; 0 if `power` is None.
    """
    first_pair = tests.pair.min()
    is_used = np.bincount(tests.pair - first_pair) > 0
    pairs, pair_of_test = first_pair + np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[tests.pair - first_pair]
    row_of_pair = np.searchsorted(tests.rows, star.candidates[pairs])
    old = corners[star.touched[pairs]]
    new = np.where(star.is_moved[pairs][:, :, None], position[row_of_pair][:, None], old)
    points = samples[tests.sample]
    squared, b, c = closest_on_triangles(points, new[pair_of_test])
    costs = tests.max_distance(squared)
    costs[row_of_pair[_has_folded(old, new)]] = np.inf
    if power is None:
        return costs, np.zeros((len(tests.rows), 3))
    nearest = segment_argmin(squared, tests.starts)
    barycentric = np.stack([1.0 - b[nearest] - c[nearest], b[nearest], c[nearest]], axis=1)
    triangle = pair_of_test[nearest]
    offsets = points[nearest] - np.einsum("nk,nkj->nj", barycentric, new[triangle])
    distances = np.sqrt(squared[nearest])
    max_distance = tests.max_distance(squared)[tests.row]
    moved_fraction = (barycentric * star.is_moved[pairs][triangle]).sum(axis=1)
    normals = face_areas_and_normals(new)[1][triangle]
    has_offset = distances > MIN_DIRECTION_DISTANCE * max_distance
    directions = np.where(has_offset[:, None], offsets / np.where(has_offset, distances, 1.0)[:, None], normals)
    jacobian = moved_fraction[:, None] * directions
    irls_weights = (distances / np.where(max_distance > 0.0, max_distance, 1.0)) ** (power - 2.0)
    bins = np.flatnonzero(np.diff(tests.row, prepend=-1))
    normal_matrix = np.add.reduceat(irls_weights[:, None, None] * jacobian[:, :, None] * jacobian[:, None, :], bins)
    rhs = np.add.reduceat((irls_weights * distances)[:, None] * jacobian, bins)
    damping = PLACEMENT_DAMPING * np.trace(normal_matrix, axis1=1, axis2=2) + TINY
    displacements = np.linalg.solve(normal_matrix + damping[:, None, None] * np.eye(3), rhs[:, :, None])[:, :, 0]
    return costs, displacements / (power - 1.0)


def _expand_ranges(starts: np.ndarray, stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Concatenate the ranges starts[i]..stops[i] - 1. Returns i and the value for each entry."""
    sizes = stops - starts
    index = np.repeat(np.arange(len(starts)), sizes)
    return index, concatenate_ranges(starts, sizes)
