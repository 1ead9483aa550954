"""The samples of a field as a file of integers. Files of a build are read by window without memory mapping, so that the memory of workers
stays bounded."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.array_files import read_raw_window
from ...files.file_access import error_reason

HOLE_BIT = 1  # bit of a stored value: whether the sample is unknown; its height is then interpolated
MAX_BAND_SAMPLES = 1 << 21


@dataclass(frozen=True)
class HeightGrid:
    """A raw file of `rows` x `columns` int32 values, row 0 in the south: twice the height in steps, plus HOLE_BIT for unknown samples."""

    path: Path
    rows: int
    columns: int

    def read(self, rows: slice, columns: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (H, W) int32 in steps and a mask (H, W) bool of known samples of a window inside of the grid.

        Raises:
            FileError: the file cannot be read.
        """
        values = read_window(self.path, np.dtype(np.int32), self.columns, rows, columns)
        return values >> 1, (values & HOLE_BIT) == 0

    def read_points(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the heights (N,) int32 in steps at points (N,) of a compact region; the points are clamped to the grid."""
        x, y = np.clip(x, 0, self.columns - 1), np.clip(y, 0, self.rows - 1)
        if not len(x):
            return np.zeros(0, np.int32)
        left, right = int(x.min()), int(x.max()) + 1
        bands = list(split_rows(int(y.min()), int(y.max()) + 1, right - left))
        if len(bands) == 1:
            window, _ = self.read(bands[0], slice(left, right))
            return window[y - bands[0].start, x - left]
        heights = np.empty(len(x), np.int32)
        order = np.argsort(y, kind="stable")
        for band in bands:
            members = order[np.searchsorted(y[order], band.start) : np.searchsorted(y[order], band.stop)]
            if len(members):
                window, _ = self.read(band, slice(left, right))
                heights[members] = window[y[members] - band.start, x[members] - left]
        return heights


def encode_heights(steps: np.ndarray, is_known: np.ndarray) -> np.ndarray:
    """Return the int32 values of a HeightGrid from heights in steps, of any shape, within -2**30 to 2**30."""
    return (steps.astype(np.int32) << 1) | np.where(is_known, 0, HOLE_BIT).astype(np.int32)


def split_rows(start: int, stop: int, width: int) -> Iterator[slice]:
    """Yield bands of rows that contain at most MAX_BAND_SAMPLES samples (one row at least)."""
    size = max(MAX_BAND_SAMPLES // max(width, 1), 1)
    for first in range(start, stop, size):
        yield slice(first, min(first + size, stop))


def read_window(path: Path, dtype: np.dtype, width: int, rows: slice, columns: slice) -> np.ndarray:
    """Return a window (h, w) of a file of a build that holds an array whose rows have `width` elements.

    Raises:
        FileError: the file cannot be read.
    """
    try:
        with path.open("rb", buffering=0) as file:
            return read_raw_window(file, 0, dtype, width, rows, columns)
    except EOFError as error:
        raise FileError(f'"{path}" is truncated; build the terrain again.') from error
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error_reason(error)}; build the terrain again.') from error
