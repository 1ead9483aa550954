"""The order of increments: of all scans of all tiles, those first that improve the image most per byte."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

MAX_GAIN = 65504.0  # the largest 16-bit float


class QueuedIncrements(NamedTuple):
    """Increments in order: the row of the tile in `errors`, the first scan and the number of scans, (N,) int64 each, and by how much the
    error falls, (N,) float64."""

    rows: np.ndarray
    first_scans: np.ndarray
    scan_counts: np.ndarray
    gains: np.ndarray


def order_increments(sizes: np.ndarray, errors: np.ndarray) -> QueuedIncrements:
    """Return all increments in descending order of gain per byte.

    The scans of a tile are joined to increments so that the gain per byte falls from each to the next: the corners of the lower convex hull
    of its errors over bytes. Scans at the end without gain are left out.

    Args:
        sizes: (R, K) bytes of scans of tiles, 0 for those that a tile does not have. errors: (R, K + 1), of each tile without and with
            its first scans.
    """
    rows, firsts, counts, gains, byte_counts = [], [], [], [], []
    ends = np.concatenate([np.zeros((len(sizes), 1), np.int64), np.cumsum(sizes, axis=1)], axis=1)
    for row, (bytes_of_tile, errors_of_tile) in enumerate(zip(ends.tolist(), errors.tolist(), strict=True)):
        corners = _find_hull(bytes_of_tile, errors_of_tile)
        for first, last in pairwise(corners):
            rows.append(row)
            firsts.append(first)
            counts.append(last - first)
            gains.append(errors_of_tile[first] - errors_of_tile[last])
            byte_counts.append(bytes_of_tile[last] - bytes_of_tile[first])
    efficiencies = np.array(gains) / np.maximum(byte_counts, 1)
    order = np.lexsort((firsts, rows, -efficiencies)) if rows else np.zeros(0, np.int64)
    return QueuedIncrements(
        *(np.array(values, dtype)[order] for values, dtype in ((rows, int), (firsts, int), (counts, int), (gains, float)))
    )


def _find_hull(positions: list[int], errors: list[float]) -> list[int]:
    """Return the indices of the corners of the lower convex hull that falls, from the first point on. Equal slopes are joined."""
    hull = [0]
    for index in range(1, len(positions)):
        if positions[index] == positions[index - 1] or errors[index] >= errors[hull[-1]]:
            continue
        while len(hull) > 1 and _compute_rate(positions, errors, hull[-1], index) >= _compute_rate(positions, errors, hull[-2], hull[-1]):
            hull.pop()
        hull.append(index)
    while len(hull) > 1 and _compute_rate(positions, errors, hull[-2], hull[-1]) <= 0.0:
        hull.pop()
    return hull


def _compute_rate(positions: list[int], errors: list[float], first: int, second: int) -> float:
    return (errors[first] - errors[second]) / (positions[second] - positions[first])
