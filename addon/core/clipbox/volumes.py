"""The voxels of a box, held so that a move works out only what is new (sections 3.2 and 3.6 of the paper)."""

from collections.abc import Callable
from itertools import product

import numpy as np

from ..progress import Progress, Steps
from .grids import Grid

LAYERS = 1 << 19  # voxels that are worked out between two steps

Fill = Callable[[Grid], np.ndarray]


class Volume:
    """A cube of voxels that wraps around: voxel i lies at i modulo its side, wherever the cube is.

    origin: (3,) int64 its first voxel, or None while it is empty. computed, reused: voxels that
    moves have worked out and kept; where it stays is no move.
    """

    def __init__(self, side: int, voxel: float, fill: Fill) -> None:
        self.side, self.voxel = side, voxel
        self.origin: np.ndarray | None = None
        self.computed = self.reused = 0
        self._fill = fill
        self._data: np.ndarray | None = None

    def move(self, origin: np.ndarray) -> Steps[None]:
        """Let the cube begin at `origin` (3,), and work out the slabs that are new. When it is stopped or fails, nothing has moved."""
        if self.origin is not None and np.array_equal(self.origin, origin):
            return
        slabs = _slabs(self.origin, origin, self.side)
        parts = []
        for low, high in slabs:
            grid = Grid(tuple(low.tolist()), tuple((high - low).tolist()), self.voxel)
            for layer in grid.layers(max(1, LAYERS // (grid.shape[1] * grid.shape[2]))):
                yield Progress(0.0, "Working out voxels")
                parts.append((layer, self._fill(layer)))
        if self._data is None and parts:
            self._data = np.empty((self.side,) * 3, parts[0][1].dtype)
        for layer, values in parts:
            self._data[self._places(layer.origin, layer.shape)] = values
        new = sum(int(np.prod(high - low)) for low, high in slabs)
        self.computed += new
        self.reused += self.side**3 - new if self.origin is not None else 0
        self.origin = np.array(origin, np.int64)

    def window(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """A copy of the voxels `low` to `high` (3,), all within the cube."""
        spans = [_segments(first, last, self.side) for first, last in zip(low.tolist(), high.tolist(), strict=True)]
        if all(len(each) == 1 for each in spans):
            return self._data[tuple(source for ((source, _),) in spans)].copy()
        found = np.empty(tuple((high - low).tolist()), self._data.dtype)
        for parts in product(*spans):
            found[tuple(target for _, target in parts)] = self._data[tuple(source for source, _ in parts)]
        return found

    def at(self, voxels: np.ndarray) -> np.ndarray:
        """The voxels (...) at indices (..., 3), all within the cube."""
        x, y, z = np.moveaxis(voxels % self.side, -1, 0)
        return self._data[x, y, z]

    def _places(self, origin: tuple[int, int, int], shape: tuple[int, int, int]) -> tuple[np.ndarray, ...]:
        return np.ix_(*(np.arange(low, low + count) % self.side for low, count in zip(origin, shape, strict=True)))


def _segments(low: int, high: int, side: int) -> list[tuple[slice, slice]]:
    """Where the voxels `low` to `high` lie along an axis that wraps around, and which of them these are."""
    found, at = [], low
    while at < high:
        start = at % side
        count = min(high - at, side - start)
        found.append((slice(start, start + count), slice(at - low, at - low + count)))
        at += count
    return found


def _slabs(old: np.ndarray | None, new: np.ndarray, side: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """What of the cube at `new` is not in the one at `old`: cuboids (low, high) that do not overlap."""
    low, high = np.array(new, np.int64), np.array(new, np.int64) + side
    if old is None or (np.abs(new - old) >= side).any():
        return [(low, high)]
    slabs = []
    for axis in range(3):
        start, stop = (high[axis] - (new - old)[axis], high[axis]) if new[axis] > old[axis] else (low[axis], old[axis])
        if stop > start:
            first, last = low.copy(), high.copy()
            first[axis], last[axis] = start, stop
            slabs.append((first, last))
            if start == low[axis]:
                low[axis] = stop
            else:
                high[axis] = start
    return slabs
