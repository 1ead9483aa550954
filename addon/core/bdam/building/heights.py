"""The heights of a build: a field in steps, with its holes interpolated."""

import math
from pathlib import Path

import numpy as np

from ...errors import FileError, SettingsError
from ...files.file_access import convert_os_errors
from ...files.sealed_files import read_sealed, write_sealed
from ...jobs.progress import Progress, Steps
from ..fields.height_field import HeightField
from .height_grid import encode_heights, split_rows
from .work_folder import ADVICE

MAX_STEPS = 2**29  # stored heights lie between minus and plus this many steps
STEPS_PER_CELL = 200.0  # of sources with real numbers: 0.1 m for cells of 20 m
DONE_SUFFIX = ".done"


def choose_height_step(field: HeightField, wanted: float) -> float:
    """Return the meters between two stored heights: `wanted` if positive, otherwise that of the source or a round fraction of a cell."""
    if wanted > 0.0:
        return wanted
    if field.height_step is not None:
        return field.height_step
    step = field.cell_size / STEPS_PER_CELL
    magnitude = 10.0 ** math.floor(math.log10(step))
    return max(factor * magnitude for factor in (1.0, 2.0, 5.0) if factor * magnitude <= step * (1.0 + 1e-9))


def write_heights(field: HeightField, path: Path, height_step: float) -> Steps[int]:
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
