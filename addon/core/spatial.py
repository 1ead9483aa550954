"""Nearness: which primitives lie close to which, measured between the primitives themselves and not only between their centroids."""

import numpy as np
from scipy.spatial import cKDTree

from .parallel import in_chunks

CHUNK = 1 << 13  # pairs worked on at once: the temporaries stay within the processor's cache
SAMPLED_SHARE = 4.0  # a primitive this much larger than the median is sampled by further points


def neighbour_pairs(corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs that join every primitive to its `count` nearest ones.

    Candidates come from a k-d tree over centroids (large primitives bring several points); they are then ranked by the distance
    between primitives, which is zero where two share a corner.

    Args:
        corners: (P, C, 3) float64 corner positions; C = 3 for triangles, other primitives are taken by their corners and centroid.
        count: neighbours a primitive, n in section 4.3.1 of the billboard-cloud paper.

    Returns:
        pairs (E, 2) int32 with pairs[:, 0] < pairs[:, 1], sorted and unique; distances (E,) float64.
    """
    total = len(corners)
    if total < 2:
        return np.empty((0, 2), np.int32), np.empty(0)
    pairs = _candidates(corners, min(count + count // 4, total - 1))
    distances = primitive_distances(corners, pairs)
    near = nearest_pairs(pairs, distances, total, count)
    return pairs[near], distances[near]


def nearest_pairs(pairs: np.ndarray, distances: np.ndarray, total: int, count: int) -> np.ndarray:
    """Which of `pairs` (E, 2) between `total` things join one of their ends to its `count` nearest: (E,) bool."""
    ends = pairs.T.reshape(-1)
    by_distance = np.tile(np.argsort(distances, kind="stable"), 2)
    by_distance[len(pairs) :] += len(pairs)
    by_distance = by_distance.reshape(2, -1).T.reshape(-1)
    order = by_distance[np.argsort(ends[by_distance], kind="stable")]
    first = np.searchsorted(ends[order], np.arange(total))
    rank = np.empty(len(ends), np.int64)
    rank[order] = np.arange(len(ends)) - first[ends[order]]
    return (rank < count).reshape(2, -1).any(axis=0)


def _candidates(corners: np.ndarray, count: int) -> np.ndarray:
    """Unique pairs (E, 2) int32 of primitives whose sample points are near each other."""
    centroids = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    large = np.flatnonzero(radii > SAMPLED_SHARE * max(float(np.median(radii)), 1e-300))
    steps = np.linspace(0.0, 1.0, 5)[1:]
    extra = centroids[large, None, None] + (corners[large] - centroids[large, None])[:, :, None] * steps[:, None]
    samples = np.concatenate([centroids, extra.reshape(-1, 3)])
    owner = np.concatenate([np.arange(len(corners)), np.repeat(large, corners.shape[1] * len(steps))])
    _, near = cKDTree(samples).query(samples, k=min(count + 1, len(samples)), workers=-1)
    keys = pair_keys(np.repeat(owner, near.shape[1]), owner[near].reshape(-1), len(corners))
    return split_keys(keys, len(corners))


def keys_of(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """One number, int64, for each unordered pair (first, second) of numbers below `count`."""
    return np.minimum(first, second).astype(np.int64) * count + np.maximum(first, second)


def pair_keys(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Sorted unique keys of the unordered pairs (first, second) of numbers below `count`; pairs of equals are left out."""
    return sorted_unique(keys_of(first, second, count)[first != second])[0]


def sorted_unique(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The different values of `keys` (K,) in order, and where each stands first. Sorting integers beats numpy.unique's hashing here."""
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    starts = np.flatnonzero(np.concatenate([np.ones(min(len(keys), 1), bool), ordered[1:] != ordered[:-1]]))
    return ordered[starts], order[starts]


def split_keys(keys: np.ndarray, count: int) -> np.ndarray:
    """The pairs (E, 2) int32 that `keys_of` has packed."""
    return np.stack([keys // count, keys % count], axis=1).astype(np.int32)


def primitive_distances(corners: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Distances (E,) between the primitives of each pair: exact for disjoint triangles, zero where two touch at a corner."""
    if corners.shape[1] != 3:
        centroids = corners.mean(axis=1)
        radii = np.linalg.norm(corners - centroids[:, None], axis=2).mean(axis=1)
        gaps = np.linalg.norm(centroids[pairs[:, 0]] - centroids[pairs[:, 1]], axis=1)
        return np.maximum(gaps - radii[pairs].sum(axis=1), 0.0)
    _, welded = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    welded = welded.reshape(-1, 3)

    def chunk(part: np.ndarray) -> np.ndarray:
        a, b = part.T
        distances = np.zeros(len(part))
        apart = ~(welded[a][:, :, None] == welded[b][:, None, :]).any(axis=(1, 2))
        distances[apart] = triangle_distances(corners[a[apart]], corners[b[apart]])
        return distances

    return in_chunks(chunk, pairs, CHUNK)


def triangle_distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Distances (E,) between disjoint triangles (E, 3, 3): the least of 9 edge-edge and 6 corner-face distances."""
    squared = np.full(len(first), np.inf)
    for i in range(3):
        start, end = first[:, i], first[:, (i + 1) % 3]
        for j in range(3):
            np.minimum(squared, _segments_squared(start, end - start, second[:, j], second[:, (j + 1) % 3] - second[:, j]), out=squared)
        np.minimum(squared, _over_face_squared(start, second), out=squared)
        np.minimum(squared, _over_face_squared(second[:, i], first), out=squared)
    return np.sqrt(squared)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)


def _segments_squared(p: np.ndarray, u: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Squared distances between segments p + s u and q + t v, s and t in 0..1."""
    w = p - q
    a, b, c, d, e = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    tiny = np.finfo(float).tiny
    denominator = a * c - b * b
    s = np.clip(np.where(denominator > 1e-12 * a * c, b * e - c * d, 0.0) / np.maximum(denominator, tiny), 0.0, 1.0)
    t = np.clip((b * s + e) / np.maximum(c, tiny), 0.0, 1.0)
    s = np.clip((b * t - d) / np.maximum(a, tiny), 0.0, 1.0)
    gap = w + s[:, None] * u - t[:, None] * v
    return _dot(gap, gap)


def _over_face_squared(point: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Squared distances of points to triangles where the foot lies inside, infinity elsewhere (edges answer for those)."""
    u, v, w = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0], point - triangle[:, 0]
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    area = uu * vv - uv * uv
    s, t = vv * uw - uv * vw, uu * vw - uv * uw
    inside = (s >= 0.0) & (t >= 0.0) & (s + t <= area) & (area > 0.0)
    divisor = np.where(inside, area, 1.0)
    foot = w - (s / divisor)[:, None] * u - (t / divisor)[:, None] * v
    return np.where(inside, _dot(foot, foot), np.inf)


def contract(pairs: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """Pairs (E', 2) between the groups `labels` (P,) of `count` that hold the ends of `pairs`; unique, no loops."""
    return split_keys(pair_keys(labels[pairs[:, 0]], labels[pairs[:, 1]], count), count)
