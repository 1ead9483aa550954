"""Which triangles of a UV map lie over each other, pair by pair.

Triangles lie in grids by their size, each in the one cell of the grid of its level where its lower left corner is. Whatever meets a box
lies in a few cells of every level, and those of a row are neighbours in the order of the grid.
"""

from collections.abc import Iterator

import numpy as np

from ..parallel import slices
from ..progress import Progress, Steps
from .plane import cross, signed_areas

LEVELS = 24  # of halved cells, from the largest triangle on
TOUCH = 1e-9  # of the extent of the map: triangles that come no farther into each other only touch
CHUNK = 1 << 13  # triangles whose neighbours are looked up at once


def overlap_count(corners: np.ndarray) -> Steps[int]:
    """How many pairs of triangles (T, 3, 2) lie over each other; triangles without area do with none."""
    areas = signed_areas(corners)
    yield Progress(0.0, "Looking for overlaps")
    corners = np.where((areas < 0.0)[:, None, None], corners[:, ::-1], corners)[areas != 0.0]
    if len(corners) < 2:
        return 0
    extent = float(np.ptp(corners.reshape(-1, 2), axis=0).max())
    yield Progress(0.0, "Looking for overlaps")
    total = 0
    for share, first, second in _candidates(corners):
        yield Progress(share, "Looking for overlaps")
        total += int(_overlap(corners[first], corners[second], TOUCH * extent).sum())
    return total


def _candidates(corners: np.ndarray) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Pairs of triangles whose boxes may meet, every pair once, and what share of them has been looked at."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    low, high = low - low.min(axis=0), high - low.min(axis=0)
    sizes = (high - low).max(axis=1)
    levels = np.clip(np.floor(np.log2(sizes.max() / sizes)), 0, LEVELS).astype(np.int64)
    order = np.argsort(-levels, kind="stable")
    filled = np.unique(levels)
    for number, level in enumerate(filled):
        side = sizes.max() / 2.0**level
        members = np.flatnonzero(levels == level)
        columns = int(high[:, 0].max() / side) + 2
        cells = (low[members] // side).astype(np.int64)
        keys = cells[:, 1] * columns + cells[:, 0]
        members, keys = members[np.argsort(keys, kind="stable")], np.sort(keys)
        finer = order[: int(np.searchsorted(-levels[order], -level, side="right"))]
        for chunk in slices(len(finer), CHUNK):
            asking = finer[chunk]
            left, right = np.maximum(low[asking, 0] // side - 1, 0), high[asking, 0] // side
            bottom, top = (low[asking, 1] // side - 1).astype(np.int64), (high[asking, 1] // side).astype(np.int64)
            for row in range(int((top - bottom).max()) + 1):
                line = (bottom + row) * columns
                first = np.searchsorted(keys, line + left.astype(np.int64))
                last = np.where(bottom + row <= top, np.searchsorted(keys, line + right.astype(np.int64), side="right"), first)
                own = np.repeat(np.arange(len(asking)), last - first)
                met = members[np.arange(len(own)) - np.repeat(np.cumsum(last - first) - last, last - first)]
                own = asking[own]
                new = (levels[own] > level) | (own < met)
                new &= ((low[own] <= high[met]) & (low[met] <= high[own])).all(axis=1)
                yield number / len(filled), own[new], met[new]


def _overlap(first: np.ndarray, second: np.ndarray, touch: float) -> np.ndarray:
    """Whether pairs of counter-clockwise triangles (P, 3, 2) lie over each other by more than `touch`, (P,) bool."""
    return ~(_parted(first, second, touch) | _parted(second, first, touch))


def _parted(triangles: np.ndarray, others: np.ndarray, touch: float) -> np.ndarray:
    """Whether a side of each of `triangles` (P, 3, 2) has all of the other one beyond it, (P,) bool."""
    sides = np.roll(triangles, -1, axis=1) - triangles
    lengths = np.linalg.norm(sides, axis=2)
    inwards = cross(sides[:, :, None], others[:, None] - triangles[:, :, None])
    return (inwards.max(axis=2) <= touch * lengths).any(axis=1)
