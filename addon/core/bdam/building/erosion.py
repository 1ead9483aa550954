"""Erosion of the heights of a build, out of core, from coarse to fine.

The largest level of the pyramid of heights that has at most MAX_COMPLETE samples is eroded in memory, with the levels below it first: each
begins with its own heights, lowered as the coarser level was, so that large valleys come from coarse levels and small ones from fine
levels. Finer levels are eroded in tiles, which inherit the rivers of the coarser level, see `erosion_steps.erode_window`. A tile is
computed together with as many samples around it as erosion reaches, so that the result does not depend on the tiles.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from scipy import ndimage

from ...files.atomic_write import TEMPORARY_SUFFIX
from ...files.file_access import convert_os_errors
from ...jobs.progress import Progress, Steps
from .drainage import draw_lengths
from .erosion_steps import HALO, erode, erode_window
from .height_grid import HeightGrid, encode_heights, split_rows
from .height_levels import (
    Level,
    array_level,
    delete_levels,
    expand_level,
    finest_level,
    level_path,
    open_level,
    reduce_heights,
    reduce_level,
)

MAX_COMPLETE = 1_300_000  # samples of a level that is eroded in memory, with up to 110 bytes per sample
MIN_SIDE = 32  # samples along the longer side of the coarsest level, at least
TILE = 512  # rows of a tile, even; it has twice as many columns, since a band of rows is kept in memory
BAND_SAMPLES = 1 << 20
RATE = 0.36  # See `erosion_steps.erode`; for a strength of 1.
REPOSE_GRADIENT = 0.8  # Rock rests at up to 39 degrees.
MAX_SHIFT = 2.0  # samples by which the changes of a coarser level are moved
MIN_SEA = 64  # flat samples
REDUCE_END, COMPLETE_END = 0.1, 0.2  # progress at which all levels are reduced, and at which the coarse ones are eroded


def erode_heights(source: HeightGrid, path: Path, steps_per_cell: float, strength: float) -> Steps[None]:
    """Write the eroded heights of a grid to the file `path`. Unknown samples and the sea stay as they are.

    steps_per_cell: how many steps of height are as long as a cell. strength: 1 for natural valleys.

    Raises:
        FileError: a file cannot be read or written.
    """
    repose, rate = REPOSE_GRADIENT * steps_per_cell, RATE * strength
    with convert_os_errors(f'"{source.path}" cannot be eroded'):
        sea = find_sea_level(source)
        levels = [_mask_sea(finest_level(source), sea)]
        while levels[-1].rows * levels[-1].columns > MAX_COMPLETE:
            levels.append(reduce_level(levels[-1], level_path(source, len(levels), "reduced"), BAND_SAMPLES))
            yield Progress(REDUCE_END * (1.0 - 0.25 ** len(levels)), "Eroding")
        number = len(levels) - 1
        complete = levels[number].read(slice(0, levels[number].rows), slice(0, levels[number].columns))
        changes, areas = yield from _erode_complete(complete, number, repose, rate)
        del complete
        temporary = path.with_name(path.name + TEMPORARY_SUFFIX)
        if number == 0:
            with temporary.open("wb") as file:
                _write_rows(file, source, slice(0, source.rows), changes)
        coarser = array_level(changes), array_level(areas)
        while number > 0:
            number -= 1
            level = levels[number]
            bands = _erode_bands(level, coarser, number, repose, rate)
            end = 0.25**number
            if number == 0:
                with temporary.open("wb") as file:
                    for rows, changes, _ in bands:
                        _write_rows(file, source, rows, changes)
                        yield _progress(end, rows, level)
                break
            paths = [level_path(source, number, kind) for kind in ("changes", "areas")]
            with paths[0].open("wb") as first, paths[1].open("wb") as second:
                for rows, changes, areas in bands:
                    changes.tofile(first)
                    areas.tofile(second)
                    yield _progress(end, rows, level)
            coarser = tuple(open_level(path, level.rows, level.columns) for path in paths)
        temporary.replace(path)
        delete_levels(source)


def find_sea_level(grid: HeightGrid) -> float:
    """Return the height of the sea in steps: 0 or else the lowest height, if enough ground is flat there; minus infinity without a sea.

    Raises:
        FileError: the file cannot be read.
    """
    lowest = np.inf
    counts = np.zeros(2, np.int64)  # The numbers of flat samples at 0, and at the lowest height so far.
    for rows in split_rows(0, grid.rows, grid.columns):
        steps, is_known = grid.read(rows, slice(0, grid.columns))
        inner = steps[:-1, :-1]
        flat = inner[is_known[:-1, :-1] & (inner == steps[1:, :-1]) & (inner == steps[:-1, 1:])]
        low = steps.min(where=is_known, initial=np.iinfo(np.int32).max)
        if low < lowest:
            lowest, counts[1] = low, 0
        counts += [np.count_nonzero(flat == level) for level in (0, lowest)]
    found = np.flatnonzero(counts >= MIN_SEA)
    return float((0.0, lowest)[found[0]]) if len(found) else -np.inf


def _mask_sea(level: Level, sea: float) -> Level:
    """Return a level in which samples that are not above the sea are unknown: water ends there, and nothing changes them."""

    def read(rows: slice, columns: slice) -> np.ndarray:
        heights = level.read(rows, columns)
        heights[heights <= sea] = np.nan
        return heights

    return Level(level.rows, level.columns, read)


def _progress(end: float, rows: slice, level: Level) -> Progress:
    return Progress(COMPLETE_END + (1.0 - COMPLETE_END) * end * (0.25 + 0.75 * rows.stop / level.rows), "Eroding")


def _write_rows(file: BinaryIO, source: HeightGrid, rows: slice, changes: np.ndarray) -> None:
    """Write the values of rows of a grid whose known heights change by `changes` (h, columns) steps, NaN where they are unknown."""
    for band in split_rows(rows.start, rows.stop, source.columns):
        steps, is_known = source.read(band, slice(0, source.columns))
        band_changes = changes[band.start - rows.start : band.stop - rows.start]
        np.add(steps, np.rint(np.nan_to_num(band_changes)).astype(np.int32), out=steps, where=is_known)
        encode_heights(steps, is_known).astype("<i4").tofile(file)


def _erode_complete(heights: np.ndarray, number: int, repose: float, rate: float) -> Steps[tuple[np.ndarray, np.ndarray]]:
    """Return how heights (H, W) of level `number` change, NaN where they are unknown, and areas (H, W) in cells of this level."""
    pyramid = [heights]
    while max(pyramid[-1].shape) >= 2 * MIN_SIDE:
        pyramid.append(reduce_heights(pyramid[-1]))
    changes = None
    for index in range(len(pyramid) - 1, -1, -1):
        raw = pyramid.pop()
        window = slice(0, raw.shape[0]), slice(0, raw.shape[1])
        begun = raw if changes is None else raw + _displace(_expand_changes(array_level(changes), *window), number + index)
        eroded, areas = erode(begun, repose * 2.0 ** (number + index), rate, number + index)
        changes = eroded - raw
        yield Progress(REDUCE_END + (COMPLETE_END - REDUCE_END) * 0.25**index, "Eroding")
    return changes, areas


def _displace(changes: np.ndarray, seed: int) -> np.ndarray:
    """Return the changes (H, W) of a level, moved by up to MAX_SHIFT samples, differently in every place.

    Rivers of a coarse level run along the rows, columns and diagonals of its grid, which would show in finer levels as straight valleys.
    """
    shape = changes.shape
    coarse_shape = tuple((size + 1) // 2 for size in shape)
    window = slice(0, shape[0]), slice(0, shape[1])
    positions = np.mgrid[window].astype(np.float32)
    for axis in range(2):
        moves = (2.0 * draw_lengths((0, 0), coarse_shape, ~(2 * seed + axis)) - 3.0).astype(np.float32)
        positions[axis] += np.float32(MAX_SHIFT) * expand_level(array_level(moves), *window)
    return ndimage.map_coordinates(changes, positions, order=1, mode="nearest")


def _erode_bands(
    level: Level, coarser: tuple[Level, Level], number: int, repose: float, rate: float
) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Yield rows of a level, how their heights change, and their areas; see `_erode_complete`. coarser: the same of the coarser level.

    The arrays are valid until the next ones are asked for.
    """
    buffers = np.empty((2, min(TILE, level.rows), level.columns), np.float32)
    for top in range(0, level.rows, TILE):
        rows = slice(top, min(top + TILE, level.rows))
        changes, areas = buffers[:, : rows.stop - top]
        for left in range(0, level.columns, 2 * TILE):
            columns = slice(left, min(left + 2 * TILE, level.columns))
            window = tuple(
                slice(max(axis.start - HALO, 0), min(axis.stop + HALO, size))
                for axis, size in ((rows, level.rows), (columns, level.columns))
            )
            blocks = tuple(slice(axis.start // 2, (axis.stop + 1) // 2) for axis in window)
            raw = level.read(*window)
            eroded, area = erode_window(
                raw + _expand_changes(coarser[0], *window),
                4.0 * coarser[1].read(*blocks),
                (window[0].start, window[1].start),
                repose * 2.0**number,
                rate,
                number,
            )
            inner = slice(top - window[0].start, rows.stop - window[0].start), slice(left - window[1].start, columns.stop - window[1].start)
            changes[:, columns], areas[:, columns] = (eroded - raw)[inner], area[inner]
        yield rows, changes, areas


def _expand_changes(coarser: Level, rows: slice, columns: slice) -> np.ndarray:
    """Return the bilinear interpolation (h, w) of the known changes of the coarser level in a window of the finer one."""

    def read_known(rows: slice, columns: slice) -> np.ndarray:
        return (~np.isnan(coarser.read(rows, columns))).astype(np.float32)

    def read_changes(rows: slice, columns: slice) -> np.ndarray:
        return np.nan_to_num(coarser.read(rows, columns))

    weights = expand_level(Level(coarser.rows, coarser.columns, read_known), rows, columns)
    changes = expand_level(Level(coarser.rows, coarser.columns, read_changes), rows, columns)
    return np.divide(changes, weights, out=np.zeros_like(changes), where=weights > 0.0)
