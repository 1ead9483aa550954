"""Several elevation models as one grid: neighbors abut, or have one row or column of samples in common."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import FileError, SettingsError
from ...files.height_maps import MAX_SAMPLES
from ...geometry.placements import Placement
from ...heights.sources import HeightSource

MIN_SAMPLES = 2  # along each side
MAX_OFFSET = 1e11  # cells from the world's zero to the field; beyond, float64 has less than five decimals of a cell
MAX_DRIFT = 0.05  # cells by which samples of a file may differ from the common grid; headers have rounded numbers


@dataclass(frozen=True, eq=False)
class Mosaic:
    """Sources on a common grid. Where they overlap, the first one that knows the height is used.

    Attributes:
        sources: the files, in the order in which they were given.
        corners: (N, 2) int64, row and column of the first sample of each source.
        sizes: (N, 2) int64, rows and columns of each source.
        shape: rows and columns of the grid.
        placement: position of the grid.
    """

    sources: tuple[HeightSource, ...]
    corners: np.ndarray
    sizes: np.ndarray
    shape: tuple[int, int]
    placement: Placement

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return heights (h, w) float32 of a window, NaN where nothing is known."""
        heights = np.full((rows.stop - rows.start, columns.stop - columns.start), np.nan, np.float32)
        for index in self.find_sources(rows, columns):
            inner, target = self._overlap(index, rows, columns)
            part = self.sources[index].read(*inner)
            window = heights[target]
            np.copyto(window, part, where=np.isnan(window))
        return heights

    def find_sources(self, rows: slice, columns: slice) -> list[int]:
        """Return the indices of the sources that a window touches, in the order in which the files were given."""
        low, high = (rows.start, columns.start), (rows.stop, columns.stop)
        return np.flatnonzero(((self.corners < high) & (self.corners + self.sizes > low)).all(axis=1)).tolist()

    def _overlap(self, index: int, rows: slice, columns: slice) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
        """Return the part of a source that lies in a window, and its place there."""
        inner, target = [], []
        for window, corner, size in zip((rows, columns), self.corners[index].tolist(), self.sizes[index].tolist(), strict=True):
            start, stop = max(window.start, corner), min(window.stop, corner + size)
            inner.append(slice(start - corner, stop - corner))
            target.append(slice(start - window.start, stop - window.start))
        return tuple(inner), tuple(target)

    def find_common_edges(self) -> list[tuple[int, int, tuple[slice, slice]]]:
        """Return pairs of sources that have samples in common, in the order of the files, and the rows and columns of these samples."""
        edges = []
        for index in range(len(self.sources)):
            low = np.maximum(self.corners[index], self.corners[index + 1 :])
            high = np.minimum(self.corners[index] + self.sizes[index], (self.corners + self.sizes)[index + 1 :])
            for other in np.flatnonzero((high > low).all(axis=1)):
                rows, columns = (slice(int(start), int(stop)) for start, stop in zip(low[other], high[other], strict=True))
                edges.append((index, index + 1 + int(other), (rows, columns)))
        return edges


def check_source(source: HeightSource) -> HeightSource:
    """Return a source. Raises FileError if it has too few or too many samples, or its position is too far away."""
    path, (rows, columns) = source.path, source.shape
    if min(source.shape) < MIN_SAMPLES:
        raise FileError(f'"{path}" has {columns} by {rows} heights; terrain needs at least {MIN_SAMPLES} along each side.')
    if max(source.shape) > MAX_SAMPLES:
        raise FileError(f'"{path}" has {columns:,} by {rows:,} heights; the maximum is {MAX_SAMPLES:,} along each side.')
    if not all(abs(first) < MAX_OFFSET * step for first, step in zip(source.placement.first, source.placement.step, strict=True)):
        raise FileError(f'"{path}" has its corner at {source.placement.first}, too far away for its cells; correct its position.')
    return source


def join(sources: Sequence[HeightSource], allow_gaps: bool) -> Mosaic:
    """Put sources on a common grid, the one of the first.

    allow_gaps: whether parts of the rectangle around all sources may be missing; they are unknown then.

    Raises:
        FileError: they differ in resolution or projection, overlap by more than an edge, or have no position.
        SettingsError: parts are missing, and `allow_gaps` is off.
    """
    first = sources[0].placement
    corners = np.array([_locate(source, sources[0]) for source in sources], np.int64)
    sizes = np.array([source.shape for source in sources], np.int64)
    low = corners.min(axis=0)
    corners -= low
    rows, columns = (corners + sizes).max(axis=0).tolist()
    placement = replace(first, first=first.position(int(low[1]), int(low[0])))
    mosaic = Mosaic(tuple(sources), corners, sizes, (rows, columns), placement)
    if max(rows, columns) > MAX_SAMPLES:
        raise FileError(f'"{sources[0].path}" and the other files span {columns:,} by {rows:,} heights; the maximum is {MAX_SAMPLES:,}.')
    _check_overlaps(mosaic)
    if not allow_gaps:
        _check_gaps(mosaic)
    return mosaic


def _locate(source: HeightSource, reference: HeightSource) -> tuple[int, int]:
    """Return the row and column of the first sample of a source on the grid of the reference."""
    if source is reference:
        return 0, 0
    names = f'"{source.path}" and "{reference.path}"'
    placement, first = source.placement, reference.placement
    if not (placement.is_placed and first.is_placed):
        unplaced = source if not placement.is_placed else reference
        raise FileError(f'"{unplaced.path}" has no position, so it cannot be joined with other files; use a GeoTIFF.')
    if placement.has_other_crs(first):
        raise FileError(f"{names} have different projections ({placement.crs} and {first.crs}); warp one to the projection of the other.")
    count = max(*source.shape, *reference.shape)
    if any(abs(step - other) * count > MAX_DRIFT * other for step, other in zip(placement.step, first.step, strict=True)):
        sizes = " and ".join(f"{step[0]:g} by {step[1]:g}" for step in (placement.step, first.step))
        raise FileError(f"{names} have different resolutions (cells of {sizes}); resample one to the resolution of the other.")
    offset = [placement.first[axis] - first.first[axis] for axis in range(2)]
    if first.is_geographic:
        offset[0] -= 360.0 * round(offset[0] / 360.0)  # tiles on both sides of 180 degrees
    column, row = (offset[axis] / first.step[axis] for axis in range(2))
    if max(abs(column - round(column)), abs(row - round(row))) > MAX_DRIFT:
        raise FileError(f"The samples of {names} lie between each other; resample one to the grid of the other.")
    return round(row), round(column)


def _check_overlaps(mosaic: Mosaic) -> None:
    for first, second, (rows, columns) in mosaic.find_common_edges():
        if min(rows.stop - rows.start, columns.stop - columns.start) > 1:
            size = f"{columns.stop - columns.start:,} by {rows.stop - rows.start:,}"
            names = f'"{mosaic.sources[first].path}" and "{mosaic.sources[second].path}"'
            raise FileError(f"{names} overlap by {size} heights, more than a common edge; crop one of them, or leave it out.")


def _check_gaps(mosaic: Mosaic) -> None:
    """Raise SettingsError where a part of the rectangle belongs to no source."""
    edges = [np.unique(np.concatenate([mosaic.corners[:, axis], (mosaic.corners + mosaic.sizes)[:, axis]])) for axis in range(2)]
    covered = np.zeros([len(edge) - 1 for edge in edges], bool)  # the rectangles between all edges
    for corner, size in zip(mosaic.corners, mosaic.sizes, strict=True):
        rows, columns = (slice(*np.searchsorted(edges[axis], (corner[axis], corner[axis] + size[axis]))) for axis in range(2))
        covered[rows, columns] = True
    missing = np.argwhere(~covered)
    if missing.size:
        row, column = (int(edges[axis][missing[0, axis]]) for axis in range(2))
        x, y = mosaic.placement.position(column, row)
        unit = "degrees" if mosaic.placement.is_geographic else "meters"
        raise SettingsError(
            f"The files leave a gap with its south-west corner at x = {x:.10g}, y = {y:.10g} {unit}; add that file, or enable Allow Gaps.",
            ("allow_gaps",),
        )
