"""Proximity graphs of primitives, by the distance between the primitives themselves instead of between their centroids."""

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ..arrays import TINY, group_rows
from ..jobs.chunks import map_chunks

CHUNK_PAIRS = 1 << 13  # pairs at once: the temporaries fit the CPU cache
SAMPLE_FRACTION = 4.0  # a primitive this much larger than the median is sampled by further points


def neighbor_pairs(corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs that join every primitive to its `count` nearest ones.

    Candidates come from a k-d tree over centroids (large primitives contribute several points); they are then ranked by the distance
    between primitives, which is zero where two share a corner.

    Args:
        corners: (P, C, 3) float64 corner positions; C = 3 for triangles, other primitives are approximated by corners and centroid.
        count: neighbors per primitive, n in section 4.3.1 of the billboard-cloud paper.

    Returns:
        pairs (E, 2) int32 with pairs[:, 0] < pairs[:, 1], sorted and unique; distances (E,) float64.
    """
    total = len(corners)
    if total < 2:
        return np.empty((0, 2), np.int32), np.empty(0)
    pairs = _candidate_pairs(corners, min(count + count // 4, total - 1))
    distances = primitive_distances(corners, pairs)
    near = nearest_pairs(pairs, distances, total, count)
    return pairs[near], distances[near]


def nearest_pairs(pairs: np.ndarray, distances: np.ndarray, total: int, count: int) -> np.ndarray:
    """Return which of `pairs` (E, 2) between `total` items join one of their ends to its `count` nearest: (E,) bool."""
    ends = pairs.T.reshape(-1)
    by_distance = np.tile(np.argsort(distances, kind="stable"), 2)
    by_distance[len(pairs) :] += len(pairs)
    by_distance = by_distance.reshape(2, -1).T.reshape(-1)
    order = by_distance[np.argsort(ends[by_distance], kind="stable")]
    first = np.searchsorted(ends[order], np.arange(total))
    rank = np.empty(len(ends), np.int64)
    rank[order] = np.arange(len(ends)) - first[ends[order]]
    return (rank < count).reshape(2, -1).any(axis=0)


def _candidate_pairs(corners: np.ndarray, count: int) -> np.ndarray:
    """Return unique pairs (E, 2) int32 of primitives whose sample points are near each other."""
    centroids = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    large = np.flatnonzero(radii > SAMPLE_FRACTION * max(float(np.median(radii)), TINY))
    steps = np.linspace(0.0, 1.0, 5)[1:]
    extra = centroids[large, None, None] + (corners[large] - centroids[large, None])[:, :, None] * steps[:, None]
    samples = np.concatenate([centroids, extra.reshape(-1, 3)])
    owner = np.concatenate([np.arange(len(corners)), np.repeat(large, corners.shape[1] * len(steps))])
    _, nearest = cKDTree(samples).query(samples, k=min(count + 1, len(samples)), workers=-1)
    keys = unique_pair_keys(np.repeat(owner, nearest.shape[1]), owner[nearest].reshape(-1), len(corners))
    return decode_pairs(keys, len(corners))


def encode_pairs(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Return one int64 key per unordered pair (first, second) of indices below `count`."""
    return np.minimum(first, second).astype(np.int64) * count + np.maximum(first, second)


def argsort_pairs(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Return the order (N,) int32 of the unordered pairs `first`, `second` (N,) of indices below `count` by their keys from `encode_pairs`,
    stable. Two counting sorts, several times as fast as sorting the keys."""
    order = counting_argsort(np.maximum(first, second), count)
    return order[counting_argsort(np.minimum(first, second)[order], count)]


def counting_argsort(values: np.ndarray, count: int) -> np.ndarray:
    """Return the stable order (N,) int32 of the integers `values` (N,) from 0 to below `count`."""
    rows = np.arange(len(values) + 1, dtype=np.int32)
    return sparse.csr_array((rows[:-1], values.astype(np.int32), rows), shape=(len(values), count)).tocsc().data


def unique_pair_keys(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Return the sorted unique keys of the unordered pairs (first, second) of indices below `count`, without pairs of equal indices."""
    return sorted_unique(encode_pairs(first, second, count)[first != second])[0]


def sorted_unique(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sorted unique values of `keys` (K,) and the index of the first occurrence of each. Sorting integers is faster here than
    the hashing of numpy.unique."""
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    starts = np.flatnonzero(np.concatenate([np.ones(min(len(keys), 1), bool), ordered[1:] != ordered[:-1]]))
    return ordered[starts], order[starts]


def decode_pairs(keys: np.ndarray, count: int) -> np.ndarray:
    """Return the pairs (E, 2) int32 encoded by `encode_pairs`."""
    return np.stack([keys // count, keys % count], axis=1).astype(np.int32)


def primitive_distances(corners: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return the distances (E,) between the primitives of each pair: exact for disjoint triangles, zero for a shared corner."""
    if corners.shape[1] != 3:
        centroids = corners.mean(axis=1)
        radii = np.linalg.norm(corners - centroids[:, None], axis=2).mean(axis=1)
        gaps = np.linalg.norm(centroids[pairs[:, 0]] - centroids[pairs[:, 1]], axis=1)
        return np.maximum(gaps - radii[pairs].sum(axis=1), 0.0)
    welded = group_rows(corners.reshape(-1, 3)).reshape(-1, 3)

    def chunk_distances(chunk: np.ndarray) -> np.ndarray:
        a, b = chunk.T
        distances = np.zeros(len(chunk))
        is_disjoint = ~(welded[a][:, :, None] == welded[b][:, None, :]).any(axis=(1, 2))
        distances[is_disjoint] = triangle_distances(corners[a[is_disjoint]], corners[b[is_disjoint]])
        return distances

    return map_chunks(chunk_distances, pairs, CHUNK_PAIRS)


def triangle_distances(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the distances (E,) between disjoint triangles (E, 3, 3): the minimum of 9 edge-edge and 6 corner-face distances."""
    squared = np.full(len(first), np.inf)
    for i in range(3):
        start, end = first[:, i], first[:, (i + 1) % 3]
        for j in range(3):
            other_edge = second[:, (j + 1) % 3] - second[:, j]
            np.minimum(squared, _squared_segment_distances(start, end - start, second[:, j], other_edge), out=squared)
        np.minimum(squared, _squared_face_distances(start, second), out=squared)
        np.minimum(squared, _squared_face_distances(second[:, i], first), out=squared)
    return np.sqrt(squared)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)


def _squared_segment_distances(p: np.ndarray, u: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return squared distances between segments p + s u and q + t v, s and t in 0..1."""
    w = p - q
    a, b, c, d, e = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    tiny = np.finfo(float).tiny
    denominator = a * c - b * b
    s = np.clip(np.where(denominator > 1e-12 * a * c, b * e - c * d, 0.0) / np.maximum(denominator, tiny), 0.0, 1.0)
    t = np.clip((b * s + e) / np.maximum(c, tiny), 0.0, 1.0)
    s = np.clip((b * t - d) / np.maximum(a, tiny), 0.0, 1.0)
    offset = w + s[:, None] * u - t[:, None] * v
    return _dot(offset, offset)


def _squared_face_distances(point: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Return squared distances of points to triangles that contain their projection, infinity elsewhere (edges cover that case)."""
    u, v, w = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0], point - triangle[:, 0]
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    area_squared = uu * vv - uv * uv
    s, t = vv * uw - uv * vw, uu * vw - uv * uw
    is_inside = (s >= 0.0) & (t >= 0.0) & (s + t <= area_squared) & (area_squared > 0.0)
    divisor = np.where(is_inside, area_squared, 1.0)
    offset = w - (s / divisor)[:, None] * u - (t / divisor)[:, None] * v
    return np.where(is_inside, _dot(offset, offset), np.inf)


def contract(pairs: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """Return the pairs (E', 2) between the groups `labels` (P,) of `count` that contain the ends of `pairs`; unique, no loops."""
    return decode_pairs(unique_pair_keys(labels[pairs[:, 0]], labels[pairs[:, 1]], count), count)
