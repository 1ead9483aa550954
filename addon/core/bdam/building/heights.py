"""The heights of a build: a field in steps, with its unknown heights interpolated or filled.

Heights that nobody sees are interpolated along rows. If holes are to be filled, it is done smoothly from the heights around them, out of
core: a pyramid as in Gortler et al., The Lumigraph, 1996, section 3.4 (push-pull), made a solver of Laplace's equation by relaxation. Every
coarser level has the means of the known heights of 2 x 2 samples. From the coarsest level on, unknown heights are first interpolated from
the coarser level and then replaced RELAXATIONS times by the mean of their four neighbors, so that they meet the known heights without a
step (a cascadic multigrid method: Bornemann and Deuflhard, 1996). Heights that are known stay as they are.

All levels are files that are read in bands of rows. A band is computed together with as many rows around it as relaxation reaches, so that
the result does not depend on the bands.
"""

import math
from pathlib import Path

import numpy as np

from ...errors import FileError, SettingsError
from ...files.atomic_write import TEMPORARY_SUFFIX
from ...files.file_access import convert_os_errors
from ...files.sealed_files import read_sealed, write_sealed
from ...jobs.progress import Progress, Steps
from ..fields.terrain_field import TerrainField
from .height_grid import HeightGrid, encode_heights, split_rows
from .height_levels import Level, delete_levels, expand_level, finest_level, level_path, reduce_level, write_level
from .work_folder import ADVICE

MAX_STEPS = 2**29  # stored heights lie between minus and plus this many steps
STEPS_PER_CELL = 200.0  # for sources with real numbers: 0.1 m for cells of 20 m
DONE_SUFFIX = ".done"
RELAXATIONS = 12
BAND_SAMPLES = 1 << 20
SOLVE_START = 0.2  # progress at which all levels are reduced


def choose_height_step(field: TerrainField, wanted: float, is_eroded: bool) -> float:
    """Return the meters between two stored heights: `wanted` if positive, otherwise that of the source or a round fraction of a cell.

    is_eroded: whether heights are changed, so that a coarse step of the source would show as terraces.
    """
    if wanted > 0.0:
        return wanted
    step = field.cell_size / STEPS_PER_CELL
    magnitude = 10.0 ** math.floor(math.log10(step))
    fine = max(factor * magnitude for factor in (1.0, 2.0, 5.0) if factor * magnitude <= step * (1.0 + 1e-9))
    if field.height_step is None:
        return fine
    return min(field.height_step, fine) if is_eroded else field.height_step


def write_heights(field: TerrainField, path: Path, height_step: float) -> Steps[int]:
    """Write the heights of a field as a `HeightGrid` to `path`, unless that was finished before. Returns the number of unknown heights.

    Raises:
        FileError: a source is damaged, all heights are unknown, or the file cannot be written.
        SettingsError: the step is too small for the heights.
    """
    done = path.with_suffix(DONE_SUFFIX)
    if done.exists():
        return int(read_sealed(done, ADVICE))
    rows, columns = field.shape
    holes = 0
    previous = np.zeros(columns)
    with convert_os_errors(f'Cannot write "{path}"'), path.open("wb") as file:
        for band in split_rows(0, rows, columns):
            yield Progress(band.start / rows, "Reading heights")
            heights = field.read(band, slice(0, columns)).astype(np.float64)
            is_known = np.isfinite(heights)
            if not is_known.all():
                holes += int(is_known.size - np.count_nonzero(is_known))
                previous = _interpolate_rows(heights, is_known, previous)
            steps = np.rint(heights / height_step)
            if np.abs(steps).max() > MAX_STEPS:
                raise SettingsError(
                    f"Height Step, {height_step:g} m, is too small for heights of {np.abs(heights).max():,.0f} m; raise it.",
                    ("height_step",),
                )
            file.write(encode_heights(steps, is_known).astype("<i4").tobytes())
    if holes == rows * columns:
        raise FileError("The elevation model contains no known height: all are marked as missing; use another file.")
    write_sealed(done, str(holes).encode())
    return holes


def _interpolate_rows(heights: np.ndarray, is_known: np.ndarray, previous: np.ndarray) -> np.ndarray:
    """Fill unknown heights (H, W) in place from their neighbors in the row, or else from the row before; return the last row.

    Nobody sees these heights: triangles without known samples are not shown. They only keep triangles at the border of a hole from sloping.
    """
    columns = np.arange(heights.shape[1])
    for row, known in zip(heights, is_known, strict=True):
        if known.any():
            row[~known] = np.interp(columns[~known], columns[known], row[known])
        else:
            row[:] = previous
        previous = row
    return previous.copy()


def fill_holes(grid: HeightGrid) -> Steps[None]:
    """Make all heights of a grid known. At least one must be known. If it is interrupted, it can be started again.

    Raises:
        FileError: a file cannot be read or written.
    """
    with convert_os_errors(f'The holes of "{grid.path}" cannot be filled'):
        levels = [finest_level(grid)]
        while any(np.isnan(levels[-1].read_rows(band)).any() for band in levels[-1].bands(BAND_SAMPLES)):
            levels.append(reduce_level(levels[-1], level_path(grid, len(levels), "known"), BAND_SAMPLES))
            yield Progress(SOLVE_START * (1.0 - 0.25 ** len(levels)), "Filling holes")
        solved = levels[-1]
        for number in range(len(levels) - 2, 0, -1):
            level, coarser = levels[number], solved
            bands = (_solve_band(level, coarser, band) for band in level.bands(BAND_SAMPLES))
            solved = write_level(level_path(grid, number, "filled"), level.rows, level.columns, bands)
            yield Progress(SOLVE_START + (1.0 - SOLVE_START) * 0.25**number, "Filling holes")
        if len(levels) > 1:
            yield from _fill_samples(grid, levels[0], solved)
        delete_levels(grid)


def _fill_samples(grid: HeightGrid, level: Level, coarser: Level) -> Steps[None]:
    """Replace the file of a grid by one whose unknown heights are filled."""
    temporary = grid.path.with_name(grid.path.name + TEMPORARY_SUFFIX)
    with temporary.open("wb") as file:
        for band in level.bands(BAND_SAMPLES):
            yield Progress(SOLVE_START + (1.0 - SOLVE_START) * (0.25 + 0.75 * band.start / grid.rows), "Filling holes")
            steps, is_known = grid.read(band, slice(0, grid.columns))
            if not is_known.all():
                filled = np.rint(_solve_band(level, coarser, band))
                steps = np.where(is_known, steps, filled.astype(np.int32))
            encode_heights(steps, np.ones(steps.shape, bool)).astype("<i4").tofile(file)
    temporary.replace(grid.path)


def _solve_band(level: Level, coarser: Level, band: slice) -> np.ndarray:
    """Return the heights (h, columns) of a band with its unknown heights filled."""
    rows = slice(max(band.start - RELAXATIONS, 0), min(band.stop + RELAXATIONS, level.rows))
    heights = level.read_rows(rows)
    is_unknown = np.isnan(heights)
    inner = slice(band.start - rows.start, band.stop - rows.start)
    if not is_unknown[inner].any():
        return heights[inner]
    heights = np.where(is_unknown, expand_level(coarser, rows, slice(0, level.columns)), heights)
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
