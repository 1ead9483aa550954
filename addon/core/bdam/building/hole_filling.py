"""Unknown heights filled smoothly from those around them, out of core.

A pyramid as in Gortler et al., The Lumigraph, 1996, section 3.4 (push-pull), made a solver of Laplace's equation by relaxation: every
coarser level has the means of the known heights of 2 x 2 samples. From the coarsest level on, unknown heights are first interpolated from
the coarser level and then replaced RELAXATIONS times by the mean of their four neighbors, so that they meet the known heights without a
step (a cascadic multigrid method: Bornemann and Deuflhard, 1996). Heights that are known stay as they are.

All levels are files that are read in bands of rows. A band is computed together with as many rows around it as relaxation reaches, so that
the result does not depend on the bands.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.atomic_write import TEMPORARY_SUFFIX
from ...files.file_access import convert_os_errors
from ...jobs.progress import Progress, Steps
from .height_grid import HeightGrid, encode_heights

RELAXATIONS = 12
BAND_SAMPLES = 1 << 20
SOLVE_START = 0.2  # of the progress


@dataclass(frozen=True)
class _Level:
    """Heights (rows, columns) float32 in steps in a file, NaN where unknown."""

    path: Path
    rows: int
    columns: int

    def read(self, rows: slice) -> np.ndarray:
        with self.path.open("rb") as file:
            file.seek(4 * rows.start * self.columns)
            values = np.fromfile(file, np.float32, (rows.stop - rows.start) * self.columns)
        if values.size != (rows.stop - rows.start) * self.columns:
            raise FileError(f'"{self.path}" is truncated; build the terrain again.')
        return values.reshape(-1, self.columns)


@dataclass(frozen=True)
class _Samples:
    """The heights of a grid in the same form."""

    grid: HeightGrid

    @property
    def rows(self) -> int:
        return self.grid.rows

    @property
    def columns(self) -> int:
        return self.grid.columns

    def read(self, rows: slice) -> np.ndarray:
        steps, is_known = self.grid.read(rows, slice(0, self.grid.columns))
        return np.where(is_known, steps, np.nan).astype(np.float32)


def fill_holes(grid: HeightGrid) -> Steps[None]:
    """Make all heights of a grid known. At least one must be known. If it is interrupted, it can be started again.

    Raises:
        FileError: a file cannot be read or written.
    """
    with convert_os_errors(f'The holes of "{grid.path}" cannot be filled'):
        levels: list[_Samples | _Level] = [_Samples(grid)]
        while not _is_complete(levels[-1]):
            levels.append(_reduce(levels[-1], _level_path(grid, len(levels), "known")))
            yield Progress(SOLVE_START * (1.0 - 0.25 ** len(levels)), "Filling holes")
        solved: _Samples | _Level = levels[-1]
        for number in range(len(levels) - 2, 0, -1):
            solved = _solve(levels[number], solved, _level_path(grid, number, "filled"))
            yield Progress(SOLVE_START + (1.0 - SOLVE_START) * 0.25**number, "Filling holes")
        if len(levels) > 1:
            yield from _fill_samples(grid, levels[0], solved)
        for path in grid.path.parent.glob(f"{grid.path.stem}-*-level.raw"):
            path.unlink()


def _level_path(grid: HeightGrid, number: int, kind: str) -> Path:
    return grid.path.with_name(f"{grid.path.stem}-{kind}-{number:02d}-level.raw")


def _bands(level: _Samples | _Level) -> list[slice]:
    """Return bands of rows, with an even number of rows except for the last one."""
    size = max(BAND_SAMPLES // level.columns // 2 * 2, 2)
    return [slice(start, min(start + size, level.rows)) for start in range(0, level.rows, size)]


def _is_complete(level: _Samples | _Level) -> bool:
    return not any(np.isnan(level.read(band)).any() for band in _bands(level))


def _reduce(level: _Samples | _Level, path: Path) -> _Level:
    """Write the means of the known heights of 2 x 2 samples."""
    with path.open("wb") as file:
        for band in _bands(level):
            heights = level.read(band)
            heights = np.pad(heights, [(0, count % 2) for count in heights.shape], constant_values=np.nan)
            blocks = heights.reshape(heights.shape[0] // 2, 2, -1, 2).transpose(0, 2, 1, 3).reshape(heights.shape[0] // 2, -1, 4)
            counts = np.isfinite(blocks).sum(axis=2)
            sums = np.where(np.isfinite(blocks), blocks, 0.0).sum(axis=2)
            np.divide(sums, counts, out=np.full(sums.shape, np.nan, np.float32), where=counts > 0).astype(np.float32).tofile(file)
    return _Level(path, (level.rows + 1) // 2, (level.columns + 1) // 2)


def _solve(level: _Samples | _Level, coarser: _Samples | _Level, path: Path) -> _Level:
    """Write a level with its unknown heights filled."""
    with path.open("wb") as file:
        for band in _bands(level):
            _solve_band(level, coarser, band).astype(np.float32).tofile(file)
    return _Level(path, level.rows, level.columns)


def _fill_samples(grid: HeightGrid, level: _Samples, coarser: _Samples | _Level) -> Steps[None]:
    """Replace the file of a grid by one whose unknown heights are filled."""
    temporary = grid.path.with_name(grid.path.name + TEMPORARY_SUFFIX)
    with temporary.open("wb") as file:
        for band in _bands(level):
            yield Progress(SOLVE_START + (1.0 - SOLVE_START) * (0.25 + 0.75 * band.start / grid.rows), "Filling holes")
            steps, is_known = grid.read(band, slice(0, grid.columns))
            if not is_known.all():
                filled = np.rint(_solve_band(level, coarser, band))
                steps = np.where(is_known, steps, filled.astype(np.int32))
            encode_heights(steps, np.ones(steps.shape, bool)).astype("<i4").tofile(file)
    temporary.replace(grid.path)


def _solve_band(level: _Samples | _Level, coarser: _Samples | _Level, band: slice) -> np.ndarray:
    """Return the heights (h, columns) of a band with its unknown heights filled."""
    rows = slice(max(band.start - RELAXATIONS, 0), min(band.stop + RELAXATIONS, level.rows))
    heights = level.read(rows)
    is_unknown = np.isnan(heights)
    inner = slice(band.start - rows.start, band.stop - rows.start)
    if not is_unknown[inner].any():
        return heights[inner]
    heights = np.where(is_unknown, _expand(coarser, rows, level.columns), heights)
    padded = np.pad(heights, 1, mode="edge")
    for _ in range(RELAXATIONS):
        center = padded[1:-1, 1:-1]
        means = padded[:-2, 1:-1] + padded[2:, 1:-1]
        means += padded[1:-1, :-2]
        means += padded[1:-1, 2:]
        means *= 0.25
        np.copyto(center, means, where=is_unknown)
        padded[0], padded[-1], padded[:, 0], padded[:, -1] = padded[1], padded[-2], padded[:, 1], padded[:, -2]
    return padded[1:-1, 1:-1][inner]


def _expand(coarser: _Samples | _Level, rows: slice, columns: int) -> np.ndarray:
    """Return the bilinear interpolation (h, columns) float32 of the coarser level at rows of the finer one."""
    low, high = max(min((rows.start - 1) // 2, coarser.rows - 2), 0), min(rows.stop // 2 + 1, coarser.rows)
    values = coarser.read(slice(low, high))
    for axis, positions, first, count in (
        (0, np.arange(rows.start, rows.stop), low, coarser.rows),
        (1, np.arange(columns), 0, coarser.columns),
    ):
        centers = np.clip((positions - 0.5) / 2.0, 0.0, count - 1.0)
        start = np.minimum(centers.astype(np.int64), max(count - 2, 0))
        weights = (centers - start).astype(np.float32).reshape((-1, 1) if axis == 0 else (1, -1))
        end = np.minimum(start + 1, count - 1)
        values = np.take(values, start - first, axis) * (1.0 - weights) + np.take(values, end - first, axis) * weights
    return values
