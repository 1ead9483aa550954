"""Levels of a pyramid over the heights of a build, as files that are read by window. Every coarser level has the means of the known heights
of 2 x 2 samples."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .height_grid import HeightGrid, read_window


@dataclass(frozen=True)
class Level:
    """Heights (rows, columns) float32 in steps, NaN where unknown. read: returns those of a window."""

    rows: int
    columns: int
    read: Callable[[slice, slice], np.ndarray]

    def read_rows(self, rows: slice) -> np.ndarray:
        """Return the heights (h, columns) of some rows."""
        return self.read(rows, slice(0, self.columns))

    def bands(self, samples: int) -> list[slice]:
        """Return bands of rows with at most `samples` samples, with an even number of rows, two at least, except for the last one."""
        size = max(samples // self.columns // 2 * 2, 2)
        return [slice(start, min(start + size, self.rows)) for start in range(0, self.rows, size)]


def finest_level(grid: HeightGrid) -> Level:
    """Return the samples of a grid as a level."""

    def read(rows: slice, columns: slice) -> np.ndarray:
        steps, is_known = grid.read(rows, columns)
        return np.where(is_known, steps, np.nan).astype(np.float32)

    return Level(grid.rows, grid.columns, read)


def array_level(values: np.ndarray) -> Level:
    """Return an array (H, W) as a level."""
    return Level(*values.shape, lambda rows, columns: values[rows, columns])


def level_path(grid: HeightGrid, number: int, kind: str) -> Path:
    """Return the path of the file of level `number` of a `kind` of heights."""
    return grid.path.with_name(f"{grid.path.stem}-{kind}-{number:02d}-level.raw")


def delete_levels(grid: HeightGrid) -> None:
    """Delete the files of all levels."""
    for path in grid.path.parent.glob(f"{grid.path.stem}-*-level.raw"):
        path.unlink()


def write_level(path: Path, rows: int, columns: int, bands: Iterable[np.ndarray]) -> Level:
    """Write the heights of bands to a file, and return the level that reads them."""
    with path.open("wb") as file:
        for heights in bands:
            heights.astype(np.float32).tofile(file)
    return open_level(path, rows, columns)


def open_level(path: Path, rows: int, columns: int) -> Level:
    """Return the level of a file."""
    return Level(rows, columns, lambda rows, window: read_window(path, np.dtype(np.float32), columns, rows, window))


def reduce_level(level: Level, path: Path, samples: int) -> Level:
    """Write the means of the known heights of 2 x 2 samples, band by band of at most `samples` samples."""
    bands = (reduce_heights(level.read_rows(band)) for band in level.bands(samples))
    return write_level(path, (level.rows + 1) // 2, (level.columns + 1) // 2, bands)


def reduce_heights(heights: np.ndarray) -> np.ndarray:
    """Return the means of the known heights of 2 x 2 samples of a grid (H, W), NaN where there are none."""
    heights = np.pad(heights, [(0, count % 2) for count in heights.shape], constant_values=np.nan)
    blocks = heights.reshape(heights.shape[0] // 2, 2, -1, 2).transpose(0, 2, 1, 3).reshape(heights.shape[0] // 2, -1, 4)
    counts = np.isfinite(blocks).sum(axis=2)
    sums = np.where(np.isfinite(blocks), blocks, 0.0).sum(axis=2)
    return np.divide(sums, counts, out=np.full(sums.shape, np.nan, np.float32), where=counts > 0)


def expand_level(coarser: Level, rows: slice, columns: slice) -> np.ndarray:
    """Return the bilinear interpolation (h, w) float32 of the coarser level in a window of the finer one."""
    counts = coarser.rows, coarser.columns
    window = [
        slice(max(min((axis.start - 1) // 2, count - 2), 0), min(axis.stop // 2 + 1, count))
        for axis, count in zip((rows, columns), counts, strict=True)
    ]
    values = coarser.read(*window)
    for axis, wanted in enumerate((rows, columns)):
        first, count = window[axis].start, counts[axis]
        centers = np.clip((np.arange(wanted.start, wanted.stop) - 0.5) / 2.0, 0.0, count - 1.0)
        start = np.minimum(centers.astype(np.int64), max(count - 2, 0))
        weights = (centers - start).astype(np.float32).reshape((-1, 1) if axis == 0 else (1, -1))
        end = np.minimum(start + 1, count - 1)
        values = np.take(values, start - first, axis) * (1.0 - weights) + np.take(values, end - first, axis) * weights
    return values
