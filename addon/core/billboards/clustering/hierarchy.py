"""Generalized hierarchical face clustering (section 4.3): the merge tree, level by level.

Merging two clusters costs their texture waste e_t plus k e_t_max, where k is the level whose error the merged cluster needs, so that all
merges of a finer level come before those of a coarser one (equation 3). Pairs that are mutually cheapest are merged together, in rounds;
`benchmarks/greedy_clustering.py` compares this with one pair at a time.

Clusters are represented by sums (area, moments) and by extreme points and normals in fixed directions, so that the cost of a pair does not
depend on the size of its clusters. The extents are therefore slightly underestimated; the plane fit that follows is exact.
"""

from dataclasses import dataclass

import numpy as np

from ...geometry.directions import fibonacci_sphere
from ...geometry.proximity import contract, nearest_pairs, sorted_unique
from ...jobs.chunks import map_chunks
from ...jobs.progress import Progress, Steps, subprogress
from ..primitives import Primitives

DIRECTION_COUNT = 32  # Extreme points are kept per cluster in so many directions, about 28 degrees apart.
PAIRS_PER_CHUNK = 1 << 11  # So that temporary arrays fit into the cache of a CPU core.
INITIAL_NEIGHBORS = 10  # Per primitive, until the number of clusters has fallen to INITIAL_FRACTION: cheap early merges.
INITIAL_FRACTION = 0.25


@dataclass(frozen=True)
class ClusterBounds:
    """error: length, of the finest level. max_normal_deviation: radians. max_texture_waste: e_t_max, a ratio of areas."""

    error: float
    max_normal_deviation: float
    max_texture_waste: float


class Clusters:
    """N clusters that grow by merging: summed moments, and extreme corners and normals along D fixed directions.

    areas (N,); first_moments (N, 3) and second_moments (N, 3, 3) of the area about the origin; normal_sums (N, 3), weighted by area.
    extreme_corners (D, N): point farthest along each direction, and corner_heights (D, N), its height. extreme_normals (D, N): primitive
    whose normal is closest to each direction, and normal_heights (D, N), the cosine. Directions come first because NumPy reduces over the
    leading axis many times faster than over a short last one.
    """

    def __init__(self, primitives: Primitives, groups: np.ndarray) -> None:
        """`groups` (P,) int32: initial cluster 0..N-1 of each primitive."""
        self.points, self.normals = np.ascontiguousarray(primitives.points.T), np.ascontiguousarray(primitives.normals.T)
        members = np.argsort(groups, kind="stable")
        starts = np.searchsorted(groups[members], np.arange(int(groups.max()) + 1))
        centroids = primitives.positions.mean(axis=1)
        directions = fibonacci_sphere(DIRECTION_COUNT)
        second_moments = primitives.covariances + np.einsum("pi,pj->pij", centroids, centroids)
        areas = primitives.areas
        self.areas = np.add.reduceat(areas[members], starts)
        self.first_moments = np.add.reduceat((centroids * areas[:, None])[members], starts)
        self.second_moments = np.add.reduceat((second_moments * areas[:, None, None])[members], starts)
        self.normal_sums = np.add.reduceat((primitives.normals * areas[:, None])[members], starts)
        heights = np.einsum("di,pci->dpc", directions, primitives.positions, optimize=True)
        farthest = heights.argmax(axis=2)
        corners = np.stack([primitives.corners[np.arange(len(primitives)), column] for column in farthest])
        extremes = _find_extremes(heights.max(axis=2), members, starts)
        self.extreme_corners = np.take_along_axis(corners, extremes, axis=1)
        self.corner_heights = np.take_along_axis(heights.max(axis=2), extremes, axis=1)
        cosines = directions @ primitives.normals.T
        self.extreme_normals = _find_extremes(cosines, members, starts).astype(np.int32)
        self.normal_heights = np.take_along_axis(cosines, self.extreme_normals, axis=1)

    def merge(self, a: np.ndarray, b: np.ndarray) -> None:
        """Merge clusters `b` (M,) into clusters `a` (M,). No index may appear twice."""
        for sums in (self.areas, self.first_moments, self.second_moments, self.normal_sums):
            sums[a] += sums[b]
        for extremes, heights in ((self.extreme_corners, self.corner_heights), (self.extreme_normals, self.normal_heights)):
            extremes[:, a] = np.where(heights[:, a] >= heights[:, b], extremes[:, a], extremes[:, b])
            heights[:, a] = np.maximum(heights[:, a], heights[:, b])

    def merge_costs(self, a: np.ndarray, b: np.ndarray, bounds: ClusterBounds, coarsest: int) -> np.ndarray:
        """Compute the cost (M,) of merging clusters `a` with `b` (equation 3); infinite beyond a bound or the level `coarsest`."""
        areas = self.areas[a] + self.areas[b]
        means = (self.first_moments[a] + self.first_moments[b]) / areas[:, None]
        second_moments = (self.second_moments[a] + self.second_moments[b]) / areas[:, None, None]
        axes = np.linalg.eigh(second_moments - means[:, :, None] * means[:, None, :])[1]
        corners = _choose_farther(self.corner_heights, self.extreme_corners, a, b)
        extents = [np.ptp(_project(self.points, corners, axes[:, :, axis]), axis=0) for axis in range(3)]
        waste = extents[1] * extents[2] / areas
        levels = np.ceil(np.log2(np.maximum(0.5 * extents[0] / bounds.error, 1.0)))
        plane_normals = axes[:, :, 0]
        is_flipped = np.einsum("mi,mi->m", plane_normals, self.normal_sums[a] + self.normal_sums[b]) < 0.0
        plane_normals = plane_normals * np.where(is_flipped, -1.0, 1.0)[:, None]
        normals = _choose_farther(self.normal_heights, self.extreme_normals, a, b)
        cosines = _project(self.normals, normals, plane_normals).min(axis=0)
        costs = waste + levels * bounds.max_texture_waste
        forbidden = (waste > bounds.max_texture_waste) | (cosines < np.cos(bounds.max_normal_deviation)) | (levels > coarsest)
        return np.where(forbidden, np.inf, costs)

    def pair_costs(self, pairs: np.ndarray, bounds: ClusterBounds, coarsest: int) -> np.ndarray:
        """Compute the `merge_costs` (E,) of `pairs` (E, 2), in chunks over the CPU cores."""
        return map_chunks(lambda chunk: self.merge_costs(chunk[:, 0], chunk[:, 1], bounds, coarsest), pairs, PAIRS_PER_CHUNK)


def _choose_farther(heights: np.ndarray, extremes: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the `extremes` (D, N) of the columns `a` or `b` (M,), per entry (D, M) of that with the larger of `heights` (D, N)."""
    return np.where(heights[:, a] >= heights[:, b], extremes[:, a], extremes[:, b])


def _project(vectors: np.ndarray, indices: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Compute the heights (D, M) of the rows `indices` (D, M) of `vectors` along the axes (M, 3). vectors: (3, N), columns of its rows."""
    return vectors[0].take(indices) * axes[:, 0] + vectors[1].take(indices) * axes[:, 1] + vectors[2].take(indices) * axes[:, 2]


def _find_extremes(heights: np.ndarray, members: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Find per direction and group the primitive (D, N) with the largest of `heights` (D, P)."""
    if len(starts) == len(members):
        return np.broadcast_to(members, heights.shape)
    ordered = heights[:, members]
    maximum = np.maximum.reduceat(ordered, starts, axis=1)
    lengths = np.diff(np.append(starts, len(members)))
    positions = np.where(ordered == np.repeat(maximum, lengths, axis=1), np.arange(len(members)), len(members))
    return members[np.minimum.reduceat(positions, starts, axis=1)]


def merge_in_rounds(
    primitives: Primitives, groups: np.ndarray, pairs: np.ndarray, distances: np.ndarray, bounds: ClusterBounds, level: int
) -> Steps[np.ndarray]:
    """Merge `groups` of primitives until no merge within `level` (0 is the finest) is left.

    Args:
        groups: (P,) int32 initial cluster of each primitive, 0..N-1: itself, or its owner at the finer level.
        pairs, distances: the proximity graph of the primitives, see `neighbor_pairs`.

    Returns:
        The cluster (P,) int32 of every primitive, numbered from 0 without gaps; each cluster is a union of groups.
    """
    clusters = Clusters(primitives, groups)
    count = len(clusters.areas)
    labels = np.arange(count, dtype=np.int32)
    if count == len(primitives) and len(pairs) > INITIAL_NEIGHBORS * count:
        near = pairs[nearest_pairs(pairs, distances, count, INITIAL_NEIGHBORS)]
        steps = _merge_pairs(clusters, near, labels, bounds, level, int(INITIAL_FRACTION * count))
        labels = yield from subprogress(steps, 0.0, 0.5)
    yield Progress(0.5, "Clustering")
    all_pairs = contract(contract(pairs, groups, count), labels, count)
    labels = yield from subprogress(_merge_pairs(clusters, all_pairs, labels, bounds, level, 1), 0.5, 1.0)
    return np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int32)[groups]


def _merge_pairs(
    clusters: Clusters, pairs: np.ndarray, labels: np.ndarray, bounds: ClusterBounds, level: int, min_count: int
) -> Steps[np.ndarray]:
    """Merge mutual best pairs until none is allowed or `min_count` clusters are left. Returns the new labels (N,)."""
    total = len(labels)
    costs = clusters.pair_costs(pairs, bounds, level)
    count = initial_count = len(np.unique(labels))
    while count > min_count and len(pairs):
        a, b = pairs[find_mutual_best(pairs, costs, total)].T
        if len(a) == 0:
            break
        clusters.merge(a, b)
        count -= len(a)
        target = np.arange(total, dtype=np.int32)
        target[b] = a
        labels = target[labels]
        is_merged = np.zeros(total, bool)
        is_merged[a] = True
        pairs, costs = _relabel_pairs(pairs, costs, target)
        stale = is_merged[pairs].any(axis=1)
        costs[stale] = clusters.pair_costs(pairs[stale], bounds, level)
        yield Progress(1.0 - count / initial_count, f"Clustering, {count} clusters")
    return labels


def _relabel_pairs(pairs: np.ndarray, costs: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Replace every cluster n in the pairs by target[n]. Returns unique pairs without loops, and their costs."""
    total = len(target)
    ends = np.sort(target[pairs], axis=1).astype(np.int64)
    differ = ends[:, 0] != ends[:, 1]
    keys, first = sorted_unique(ends[differ, 0] * total + ends[differ, 1])
    return np.stack([keys // total, keys % total], axis=1).astype(np.int32), costs[differ][first]


def find_mutual_best(pairs: np.ndarray, costs: np.ndarray, total: int) -> np.ndarray:
    """Find the indices of the pairs with finite cost that are the cheapest of both their ends; ties go to the lower index."""
    order = np.flatnonzero(np.isfinite(costs))
    order = order[np.argsort(costs[order], kind="stable")]
    best = np.full(total, len(order), np.int64)
    np.minimum.at(best, pairs[order].reshape(-1), np.repeat(np.arange(len(order)), 2))
    rank = np.arange(len(order))
    return order[(best[pairs[order, 0]] == rank) & (best[pairs[order, 1]] == rank)]
