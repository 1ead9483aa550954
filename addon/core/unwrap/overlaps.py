"""Counts overlapping pairs of triangles in a UV map.

Triangles are sorted into nested grids by size. Each triangle is stored once, in the grid of its level and in the cell that holds the lower
left corner of its bounding box. A box can therefore only meet triangles of a few cells per level, and the cells of one row are
contiguous in memory.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import concatenate_ranges
from ..geometry.transforms import cross, signed_areas
from ..jobs.chunks import slices
from ..jobs.progress import Progress, Steps

MAX_LEVELS = 24  # Maximum number of grids; the cell size halves per level, starting at the largest triangle.
CONTACT_TOLERANCE = 1e-9  # Triangles that penetrate each other by no more than this fraction of the map's extent only touch.
CHUNK_SIZE = 1 << 13  # Triangles per query.
MAX_BOX_PAIRS = 1 << 20  # Bounding boxes that are compared at once.
COMMON_CORNER = 0.25  # Distance of corners that count as one, relative to the gap between other triangles,
CONTACT_PER_GAP = 1e-5  # and how deep triangles with a common corner may penetrate each other.


def count_overlaps(corner_uvs: np.ndarray) -> Steps[int]:
    """Return the number of overlapping pairs of triangles (T, 3, 2); triangles without area overlap nothing."""
    areas = signed_areas(corner_uvs)
    yield Progress(0.0, "Finding overlaps")
    corners = np.where((areas < 0.0)[:, None, None], corner_uvs[:, ::-1], corner_uvs)[areas != 0.0]
    if len(corners) < 2:
        return 0
    extent = float(np.ptp(corners.reshape(-1, 2), axis=0).max())
    yield Progress(0.0, "Finding overlaps")
    total = 0
    for fraction, first, second in _candidate_pairs(corners):
        yield Progress(fraction, "Finding overlaps")
        total += int(_overlap(corners[first], corners[second], CONTACT_TOLERANCE * extent).sum())
    return total


def _candidate_pairs(corners: np.ndarray) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Yield pairs of triangles (two index arrays) with overlapping bounding boxes, each pair once, and the fraction of work done."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    low, high = low - low.min(axis=0), high - low.min(axis=0)
    sizes = (high - low).max(axis=1)
    levels = np.clip(np.floor(np.log2(sizes.max() / sizes)), 0, MAX_LEVELS).astype(np.int64)
    order = np.argsort(-levels, kind="stable")
    used_levels = np.unique(levels)
    for level_index, level in enumerate(used_levels):
        cell_size = sizes.max() / 2.0**level
        members = np.flatnonzero(levels == level)
        columns = int(high[:, 0].max() / cell_size) + 2
        cells = (low[members] // cell_size).astype(np.int64)
        keys = cells[:, 1] * columns + cells[:, 0]
        members, keys = members[np.argsort(keys, kind="stable")], np.sort(keys)
        finer = order[: int(np.searchsorted(-levels[order], -level, side="right"))]
        for chunk in slices(len(finer), CHUNK_SIZE):
            queries = finer[chunk]
            left, right = np.maximum(low[queries, 0] // cell_size - 1, 0), high[queries, 0] // cell_size
            bottom, top = (low[queries, 1] // cell_size - 1).astype(np.int64), (high[queries, 1] // cell_size).astype(np.int64)
            for row in range(int((top - bottom).max()) + 1):
                row_start = (bottom + row) * columns
                first = np.searchsorted(keys, row_start + left.astype(np.int64))
                last = np.where(bottom + row <= top, np.searchsorted(keys, row_start + right.astype(np.int64), side="right"), first)
                query = queries[np.repeat(np.arange(len(queries)), last - first)]
                candidate = members[concatenate_ranges(first, last - first)]
                is_new = (levels[query] > level) | (query < candidate)
                is_new &= ((low[query] <= high[candidate]) & (low[candidate] <= high[query])).all(axis=1)
                yield level_index / len(used_levels), query[is_new], candidate[is_new]


def _overlap(first: np.ndarray, second: np.ndarray, tolerance: float | np.ndarray) -> np.ndarray:
    """Return whether pairs of counter-clockwise triangles (P, 3, 2) penetrate each other by more than `tolerance`, (P, 1) or for all."""
    return ~(_is_separated(first, second, tolerance) | _is_separated(second, first, tolerance))


def _is_separated(triangles: np.ndarray, others: np.ndarray, tolerance: float | np.ndarray) -> np.ndarray:
    """Return whether an edge of each of `triangles` (P, 3, 2) separates it from the other triangle, (P,) bool."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    lengths = np.linalg.norm(edges, axis=2)
    inward = cross(edges[:, :, None], others[:, None] - triangles[:, :, None])
    return (inward.max(axis=2) <= tolerance * lengths).any(axis=1)


def any_overlap(first: np.ndarray, second: np.ndarray, gap: float, joints: np.ndarray, radius: float) -> bool:
    """Return whether a triangle of `first` (N, 3, 2) overlaps one of `second` (M, 3, 2), both counter-clockwise.

    gap: distance below which triangles count as overlapping, unless they have a corner in common, or each has a corner within `radius` of
    one of `joints` (J, 2).
    """
    tree = cKDTree(joints)
    bounds = [(corners.min(axis=1) - 0.5 * gap, corners.max(axis=1) + 0.5 * gap) for corners in (first, second)]
    for _ in range(2):  # Only triangles inside the bounding box of the others can overlap them.
        (first_low, first_high), (second_low, second_high) = bounds
        if not len(first) or not len(second):
            return False
        is_near = [
            ((low <= other_high.max(axis=0)) & (high >= other_low.min(axis=0))).all(axis=1)
            for (low, high), (other_low, other_high) in (bounds, bounds[::-1])
        ]
        first, second = first[is_near[0]], second[is_near[1]]
        bounds = [(low[kept], high[kept]) for (low, high), kept in zip(bounds, is_near, strict=True)]
    (first_low, first_high), (second_low, second_high) = bounds
    for rows in slices(len(second), max(MAX_BOX_PAIRS // max(len(first), 1), 1)):
        meets = (first_low[:, None, 0] <= second_high[rows, 0]) & (second_low[rows, 0] <= first_high[:, None, 0])
        meets &= (first_low[:, None, 1] <= second_high[rows, 1]) & (second_low[rows, 1] <= first_high[:, None, 1])
        one, other = np.nonzero(meets)
        one, other = first[one], second[rows][other]
        may_touch = (np.abs(one[:, :, None] - other[:, None]).max(axis=3) <= COMMON_CORNER * gap).any(axis=(1, 2))
        may_touch |= np.logical_and(*((tree.query(corners)[0] <= radius).any(axis=1) for corners in (one, other)))
        if _overlap(one, other, np.where(may_touch, CONTACT_PER_GAP, -1.0)[:, None] * gap).any():
            return True
    return False
