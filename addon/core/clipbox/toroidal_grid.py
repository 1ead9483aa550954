"""Voxels of a box in a wrap-around array, so that a move computes only new voxels (sections 3.2 and 3.6 of the paper)."""

from collections.abc import Callable
from itertools import product

import numpy as np

from ..jobs.progress import Progress, Steps
from .terrains.grids import Grid

MAX_STEP_VOXELS = 1 << 19  # voxels that are computed between two steps

Sample = Callable[[Grid], np.ndarray]  # returns the values (X, Y, Z) of a grid


class ToroidalGrid:
    """A cube of voxels that wraps around: voxel i is stored at i modulo the side, wherever the cube is.

    origin: (3,) int64 first voxel, or None while the grid is empty. computed, reused: voxels that moves have computed and kept. A call that
    does not move the cube counts as no move.
    """

    def __init__(self, side: int, voxel_size: float, sample: Sample) -> None:
        self.side, self.voxel_size = side, voxel_size
        self.origin: np.ndarray | None = None
        self.computed = self.reused = 0
        self._sample = sample
        self._data: np.ndarray | None = None

    def move(self, origin: np.ndarray) -> Steps[None]:
        """Move the cube to `origin` (3,) and compute the new slabs. If it is cancelled or fails, nothing has changed."""
        if self.origin is not None and np.array_equal(self.origin, origin):
            return
        new_slabs = _find_new_slabs(self.origin, origin, self.side)
        computed = []
        for low, high in new_slabs:
            grid = Grid(tuple(low.tolist()), tuple((high - low).tolist()), self.voxel_size)
            for slab in grid.slabs(max(1, MAX_STEP_VOXELS // (grid.shape[1] * grid.shape[2]))):
                yield Progress(0.0, "Computing voxels")
                computed.append((slab, self._sample(slab)))
        if self._data is None and computed:
            self._data = np.empty((self.side,) * 3, computed[0][1].dtype)
        for slab, values in computed:
            for stored, part in self._split(np.array(slab.origin), np.add(slab.origin, slab.shape)):
                self._data[stored] = values[part]
        new_count = sum(int(np.prod(high - low)) for low, high in new_slabs)
        self.computed += new_count
        self.reused += self.side**3 - new_count if self.origin is not None else 0
        self.origin = np.array(origin, np.int64)

    def window(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return a copy of the voxels `low` to `high` (3,), all within the cube."""
        parts = self._split(low, high)
        if len(parts) == 1:
            return self._data[parts[0][0]].copy()
        window = np.empty(tuple((high - low).tolist()), self._data.dtype)
        for stored, part in parts:
            window[part] = self._data[stored]
        return window

    def values_at(self, voxels: np.ndarray) -> np.ndarray:
        """Return the values (...) of voxels at indices (..., 3), all within the cube."""
        x, y, z = np.moveaxis(voxels % self.side, -1, 0)
        return self._data[x, y, z]

    def cells_at(self, voxels: np.ndarray) -> np.ndarray:
        """Return the values (K, 2, 2, 2) of the two voxels along each axis from `voxels` (K, 3) on, all within the cube."""
        x, y, z = ((voxels[:, axis, None] + np.arange(2)) % self.side for axis in range(3))
        return self._data[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]

    def _split(self, low: np.ndarray, high: np.ndarray) -> list[tuple[tuple[slice, ...], tuple[slice, ...]]]:
        """Split the voxels `low` to `high` (3,) into parts that are stored contiguously: where they are stored, and in the window."""
        segments = [_wrap_segments(first, last, self.side) for first, last in zip(low.tolist(), high.tolist(), strict=True)]
        return [tuple(zip(*part, strict=True)) for part in product(*segments)]


def _wrap_segments(low: int, high: int, side: int) -> list[tuple[slice, slice]]:
    """Split the voxels `low` to `high` of a wrap-around axis into contiguous segments: stored range, and range relative to `low`."""
    segments, voxel = [], low
    while voxel < high:
        start = voxel % side
        count = min(high - voxel, side - start)
        segments.append((slice(start, start + count), slice(voxel - low, voxel - low + count)))
        voxel += count
    return segments


def _find_new_slabs(old: np.ndarray | None, new: np.ndarray, side: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the voxels of the cube at `new` that are not in the cube at `old`, as disjoint boxes (low, high)."""
    low, high = np.array(new, np.int64), np.array(new, np.int64) + side
    if old is None or (np.abs(new - old) >= side).any():
        return [(low, high)]
    slabs = []
    for axis in range(3):
        start, stop = (high[axis] - (new - old)[axis], high[axis]) if new[axis] > old[axis] else (low[axis], old[axis])
        if stop > start:
            slab_low, slab_high = low.copy(), high.copy()
            slab_low[axis], slab_high[axis] = start, stop
            slabs.append((slab_low, slab_high))
            if start == low[axis]:
                low[axis] = stop
            else:
                high[axis] = start
    return slabs
