"""Generalised hierarchical face clustering (section 4.3): the merge tree, level by level.

The merge of two clusters costs their texture waste e_t plus k e_t_max, where k is the level whose error the merged cluster needs, so
nothing of a coarser level happens before all of a finer one (equation 3). Pairs that are each other's best are merged together, round
by round; a benchmark holds that against one pair at a time.

Clusters are described by sums (area, moments) and by extreme points and normals in fixed directions, which makes a pair's cost
independent of the size of its clusters. The extents are therefore measured a little small; the fitting that follows is exact.
"""

from dataclasses import dataclass

import numpy as np

from ..directions import fibonacci_sphere
from ..parallel import in_chunks
from ..progress import Progress, Steps, scaled
from ..spatial import contract, nearest_pairs, sorted_unique
from .primitives import Primitives

DIRECTIONS = 32  # extreme points kept a cluster: about 28 degrees apart
CHUNK = 1 << 11  # pairs a chunk: its temporaries stay within a core's own cache
FIRST_NEIGHBOURS = 10  # pairs a primitive until the number of clusters has fallen to FIRST_SHARE: the cheap early merges
FIRST_SHARE = 0.25


@dataclass(frozen=True)
class ClusterBounds:
    """error: length, of the finest level. max_normal_deviation: radians. max_texture_waste: e_t_max, a ratio of areas."""

    error: float
    max_normal_deviation: float
    max_texture_waste: float


class Clusters:
    """N clusters that grow by merging: summed moments, and extreme corners and normals along fixed directions."""

    def __init__(self, primitives: Primitives, groups: np.ndarray) -> None:
        """`groups` (P,) int32: the cluster 0..N-1 that each primitive starts in."""
        self.primitives = primitives
        members = np.argsort(groups, kind="stable")
        starts = np.searchsorted(groups[members], np.arange(int(groups.max()) + 1))
        centroids = primitives.positions.mean(axis=1)
        directions = fibonacci_sphere(DIRECTIONS)
        outer = primitives.covariances + np.einsum("pi,pj->pij", centroids, centroids)
        areas = primitives.areas
        self.area = np.add.reduceat(areas[members], starts)
        self.first = np.add.reduceat((centroids * areas[:, None])[members], starts)
        self.second = np.add.reduceat((outer * areas[:, None, None])[members], starts)
        self.normal = np.add.reduceat((primitives.normals * areas[:, None])[members], starts)
        heights = np.einsum("di,pci->dpc", directions, primitives.positions, optimize=True)
        farthest = heights.argmax(axis=2)
        # Directions come first in these arrays: numpy reduces over the leading axis many times faster than over a short last one.
        corner = np.stack([primitives.corners[np.arange(len(primitives)), column] for column in farthest])
        chosen = _largest(heights.max(axis=2), members, starts)
        self.corner = np.take_along_axis(corner, chosen, axis=1)
        self.corner_height = np.take_along_axis(heights.max(axis=2), chosen, axis=1)
        facing = directions @ primitives.normals.T
        self.extreme_normal = _largest(facing, members, starts).astype(np.int32)
        self.normal_height = np.take_along_axis(facing, self.extreme_normal, axis=1)

    def merge(self, a: np.ndarray, b: np.ndarray) -> None:
        """Clusters `a` (M,) take in clusters `b` (M,); no number appears twice."""
        for sums in (self.area, self.first, self.second, self.normal):
            sums[a] += sums[b]
        for index, height in ((self.corner, self.corner_height), (self.extreme_normal, self.normal_height)):
            index[:, a] = np.where(height[:, a] >= height[:, b], index[:, a], index[:, b])
            height[:, a] = np.maximum(height[:, a], height[:, b])

    def costs(self, a: np.ndarray, b: np.ndarray, bounds: ClusterBounds, coarsest: int) -> np.ndarray:
        """Cost (M,) of merging clusters `a` with `b` (equation 3); infinite where a bound or the level `coarsest` is passed."""
        area = self.area[a] + self.area[b]
        mean = (self.first[a] + self.first[b]) / area[:, None]
        covariance = (self.second[a] + self.second[b]) / area[:, None, None] - mean[:, :, None] * mean[:, None, :]
        axes = np.linalg.eigh(covariance)[1]
        corner = np.where(self.corner_height[:, a] >= self.corner_height[:, b], self.corner[:, a], self.corner[:, b])
        extents = [np.ptp(_along(self.primitives.points, corner, axes[:, :, axis]), axis=0) for axis in range(3)]
        waste = extents[1] * extents[2] / area
        level = np.ceil(np.log2(np.maximum(0.5 * extents[0] / bounds.error, 1.0)))
        plane = axes[:, :, 0]
        plane = plane * np.where(np.einsum("mi,mi->m", plane, self.normal[a] + self.normal[b]) < 0.0, -1.0, 1.0)[:, None]
        higher = self.normal_height[:, a] >= self.normal_height[:, b]
        normal = np.where(higher, self.extreme_normal[:, a], self.extreme_normal[:, b])
        cosines = _along(self.primitives.normals, normal, plane).min(axis=0)
        cost = waste + level * bounds.max_texture_waste
        forbidden = (waste > bounds.max_texture_waste) | (cosines < np.cos(bounds.max_normal_deviation)) | (level > coarsest)
        return np.where(forbidden, np.inf, cost)

    def pair_costs(self, pairs: np.ndarray, bounds: ClusterBounds, coarsest: int) -> np.ndarray:
        """`costs` of `pairs` (E, 2), in chunks over the processor's cores."""
        return in_chunks(lambda part: self.costs(part[:, 0], part[:, 1], bounds, coarsest), pairs, CHUNK)


def _along(vectors: np.ndarray, index: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Heights (D, M) of vectors[index] (D, M, 3) along the axes (M, 3)."""
    return vectors[index, 0] * axes[:, 0] + vectors[index, 1] * axes[:, 1] + vectors[index, 2] * axes[:, 2]


def _largest(heights: np.ndarray, members: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """For each direction and group the primitive (D, N) with the largest of `heights` (D, P)."""
    if len(starts) == len(members):
        return np.broadcast_to(members, heights.shape)
    ordered = heights[:, members]
    largest = np.maximum.reduceat(ordered, starts, axis=1)
    lengths = np.diff(np.append(starts, len(members)))
    hits = np.where(ordered == np.repeat(largest, lengths, axis=1), np.arange(len(members)), len(members))
    return members[np.minimum.reduceat(hits, starts, axis=1)]


def merge_in_rounds(
    primitives: Primitives, groups: np.ndarray, pairs: np.ndarray, distances: np.ndarray, bounds: ClusterBounds, level: int
) -> Steps[np.ndarray]:
    """Merge `groups` of primitives until no merge is left within `level` (0 is the finest).

    Args:
        groups: (P,) int32 cluster that each primitive starts in, 0..N-1: itself, or its owner at the finer level.
        pairs, distances: the proximity graph of the primitives, see `spatial.neighbour_pairs`.

    Returns:
        The cluster number (P,) int32 of every primitive, from 0 without gaps; each cluster is a union of groups.
    """
    clusters = Clusters(primitives, groups)
    count = len(clusters.area)
    labels = np.arange(count, dtype=np.int32)
    if count == len(primitives) and len(pairs) > FIRST_NEIGHBOURS * count:
        near = pairs[nearest_pairs(pairs, distances, count, FIRST_NEIGHBOURS)]
        labels = yield from scaled(_merge_level(clusters, near, labels, bounds, level, int(FIRST_SHARE * count)), 0.0, 0.5)
    yield Progress(0.5, "Clustering")
    all_pairs = contract(contract(pairs, groups, count), labels, count)
    labels = yield from scaled(_merge_level(clusters, all_pairs, labels, bounds, level, 1), 0.5, 1.0)
    return np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int32)[groups]


def _merge_level(
    clusters: Clusters, pairs: np.ndarray, labels: np.ndarray, bounds: ClusterBounds, level: int, enough: int
) -> Steps[np.ndarray]:
    """Merge mutual best pairs until none is allowed or `enough` clusters are left. Returns the new labels (P,)."""
    total = len(labels)
    cost = clusters.pair_costs(pairs, bounds, level)
    count = start = len(np.unique(labels))
    while count > enough and len(pairs):
        a, b = pairs[mutual_best(pairs, cost, total)].T
        if len(a) == 0:
            break
        clusters.merge(a, b)
        count -= len(a)
        target = np.arange(total, dtype=np.int32)
        target[b] = a
        labels = target[labels]
        touched = np.zeros(total, bool)
        touched[a] = True
        pairs, cost = _relabelled(pairs, cost, target)
        stale = touched[pairs].any(axis=1)
        cost[stale] = clusters.pair_costs(pairs[stale], bounds, level)
        yield Progress(1.0 - count / start, f"Clustering, {count} clusters")
    return labels


def _relabelled(pairs: np.ndarray, cost: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs and costs after every number n has become target[n]: unique, without loops."""
    total = len(target)
    ends = np.sort(target[pairs], axis=1).astype(np.int64)
    apart = ends[:, 0] != ends[:, 1]
    keys, index = sorted_unique(ends[apart, 0] * total + ends[apart, 1])
    return np.stack([keys // total, keys % total], axis=1).astype(np.int32), cost[apart][index]


def mutual_best(pairs: np.ndarray, cost: np.ndarray, total: int) -> np.ndarray:
    """Indices of the pairs with finite cost that are the cheapest of both their ends; ties go to the lower index."""
    order = np.flatnonzero(np.isfinite(cost))
    order = order[np.argsort(cost[order], kind="stable")]
    best = np.full(total, len(order), np.int64)
    np.minimum.at(best, pairs[order].reshape(-1), np.repeat(np.arange(len(order)), 2))
    rank = np.arange(len(order))
    return order[(best[pairs[order, 0]] == rank) & (best[pairs[order, 1]] == rank)]
