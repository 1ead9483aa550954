"""Voids of a build: sets of unknown samples that are connected along rows and columns. Small ones are filled from their rims.

A small void gets the heights of a thin plate with a little tension (Smith and Wessel, Gridding with continuous curvature splines in
tension, 1990): it continues the slopes around it, and a void in a plane gets the plane. The squares of the sums of second differences, at
all samples in the void and next to it, and of the differences between neighbors are as small as possible together. Where voids are so close
that these sums would couple them, the sums are left out, so that every void is filled by itself.

The grid is read in bands of rows. A void that reaches into the next band stays open and is filled after its last row, so that the result
does not depend on the bands. In memory are a band, and the samples of those open voids that can still be small.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ...files.file_access import convert_os_errors
from ...jobs.progress import Progress, Steps
from ...messages import format_count, format_number
from .height_grid import HeightGrid, encode_heights, read_window, split_rows

MAX_SAMPLES = 40_000  # In a small void of 200 x 200, no sample is farther than 100 from known ones, the default of gdal_fillnodata.
MAX_BORDER = 0.4  # part of the outline of a small void that may be the border of the grid: it is at most four times as long as deep there
SOLVED_SAMPLES = 20_000  # voids are solved together up to the one that exceeds this number
TENSION = 0.05  # 0 is a thin plate, which overshoots most; 1 a membrane, with a kink at the rim and cusps at single known samples
NO_VOID, OTHER_VOID = -1, -2  # instead of the index of a void: of known samples, and of those of voids that are not solved together
DECIMALS = 3  # Heights are rounded to these before they become whole steps, so that exact halves do not depend on rounding errors.
SQUARE_KILOMETER = 1e6  # square meters


@dataclass(frozen=True)
class VoidCounts:
    """How many voids a build has filled, how many it has left as holes, and the samples of both."""

    filled: int = 0
    filled_samples: int = 0
    left: int = 0
    left_samples: int = 0

    def all_filled(self) -> "VoidCounts":
        """Return the counts after the remaining voids were filled as well."""
        return VoidCounts(self.filled + self.left, self.filled_samples + self.left_samples)

    def describe(self, cell_size: float) -> str:
        """Return one sentence for the user, empty if there is no void. cell_size: meters between two samples."""
        filled = f"{format_count(self.filled, 'void')} filled"
        if not self.left:
            return f"{filled}." if self.filled else ""
        area = format_number(self.left_samples * cell_size**2 / SQUARE_KILOMETER, 2)
        together = " together" if self.left > 1 else ""
        return f"{filled}, {self.left:,} left of {area} km²{together}; Fill Holes can fill all."


@dataclass(frozen=True, eq=False)
class _Samples:
    """Unknown samples of voids.

    Attributes:
        positions: (N,) int64, row * columns + column, ascending.
        voids: (N,) int64, index of the void.
        neighbors: (N,) int64, number of neighbors within the grid.
        known_neighbors: (N,) int64, number of known ones among them.
    """

    positions: np.ndarray
    voids: np.ndarray
    neighbors: np.ndarray
    known_neighbors: np.ndarray

    def select(self, mask: np.ndarray, numbers: np.ndarray) -> "_Samples":
        """Return the samples in `mask` (N,) with other indices of voids, `numbers` by index."""
        return _Samples(self.positions[mask], numbers[self.voids[mask]], self.neighbors[mask], self.known_neighbors[mask])

    def measure(self, count: int) -> np.ndarray:
        """Return (V, 3) int64 of `count` voids: samples, their sides on the border of the grid, and those towards known samples."""
        weights = np.ones(len(self.voids)), 4 - self.neighbors, self.known_neighbors
        return np.stack([np.bincount(self.voids, weight, count) for weight in weights], axis=1).astype(np.int64)


def count_voids(grid: HeightGrid) -> Steps[VoidCounts]:
    """Return the voids of a grid, all of them as left. Raises FileError if the grid cannot be read."""
    left = samples = 0
    for band, measures, _ in _find_voids(grid):
        yield Progress(band.stop / grid.rows, "Counting voids")
        left, samples = left + len(measures), samples + int(measures[:, 0].sum())
    return VoidCounts(left=left, left_samples=samples)


def fill_small_voids(grid: HeightGrid, out: Path) -> Steps[VoidCounts]:
    """Write the file of a grid to `out`, with the heights of small voids known.

    Raises:
        FileError: a file cannot be read or written.
    """
    target, counts = HeightGrid(out, grid.rows, grid.columns), np.zeros(4, np.int64)
    with convert_os_errors(f'The voids of "{grid.path}" cannot be filled'):
        shutil.copyfile(grid.path, out)
        for band, measures, samples in _find_voids(grid):
            is_small = _are_small(measures)
            for index, sizes in enumerate((measures[is_small, 0], measures[~is_small, 0])):
                counts[2 * index : 2 * index + 2] += len(sizes), sizes.sum()
            yield Progress(band.stop / grid.rows, "Filling voids")
            for members in _split(samples):
                yield Progress(band.stop / grid.rows, "Filling voids")
                positions = samples.positions[members]
                heights = _solve(grid, positions, samples.voids[members])
                _write_steps(target, positions, np.rint(np.round(heights, DECIMALS)).astype(np.int64))
    return VoidCounts(*counts.tolist())


def _are_small(measures: np.ndarray) -> np.ndarray:
    """Return whether voids with `measures` (V, 3) are filled (V,)."""
    samples, borders, known_sides = measures.T
    return (samples <= MAX_SAMPLES) & (borders <= MAX_BORDER * (borders + known_sides))


def _find_voids(grid: HeightGrid) -> Iterator[tuple[slice, np.ndarray, _Samples]]:
    """Yield for each band the `_Samples.measure` (V, 3) of the voids that end in it, and the samples of the small ones among them."""
    measures, samples = np.zeros((0, 3), np.int64), _Samples(*np.zeros((4, 0), np.int64))
    last_row = np.full(grid.columns, -1)  # the open voids that the last row of the band before belongs to, -1 for none
    for band in split_rows(0, grid.rows, grid.columns):
        labels, found = _read_voids(grid, band)
        first, count = len(measures), int(labels.max()) + 1
        joined = np.flatnonzero((last_row >= 0) & (labels[0] >= 0))
        links = coo_array((np.ones(len(joined)), (last_row[joined], first + labels[0, joined])), shape=(first + count,) * 2)
        total, numbers = connected_components(links, directed=False) if first + count else (0, np.zeros(0, np.int64))
        samples = _join(samples, found, first)
        samples = samples.select(slice(None), numbers)
        known = np.zeros((total, 3), np.int64)
        np.add.at(known, numbers, np.concatenate([measures, found.measure(count)]))

        last_row = np.where(labels[-1] >= 0, numbers[first + labels[-1]] if total else -1, -1)
        is_open = np.zeros(total, bool)
        if band.stop < grid.rows:
            is_open[last_row[last_row >= 0]] = True
        is_small = _are_small(known) & ~is_open
        yield band, known[~is_open], samples.select(is_small[samples.voids], np.arange(total))
        is_kept = is_open & (known[:, 0] <= MAX_SAMPLES)
        numbers = np.cumsum(is_open) - 1
        samples = samples.select(is_kept[samples.voids], numbers)
        measures, last_row = known[is_open], np.where(last_row >= 0, numbers[last_row] if total else -1, -1)


def _read_voids(grid: HeightGrid, band: slice) -> tuple[np.ndarray, _Samples]:
    """Return the indices (h, columns) of voids within a band, -1 for known samples, and the unknown samples."""
    low, high = max(band.start - 1, 0), min(band.stop + 1, grid.rows)
    _, is_known = grid.read(slice(low, high), slice(0, grid.columns))
    labels, _ = label(~is_known[band.start - low : band.stop - low])
    rows, columns = np.nonzero(labels)
    voids = labels[rows, columns].astype(np.int64) - 1
    positions = (rows + band.start) * grid.columns + columns
    neighbors, known_neighbors = np.zeros((2, len(rows)), np.int64)
    for offset_row, offset_column in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        row, column = rows + band.start - low + offset_row, columns + offset_column
        inside = np.flatnonzero((row >= 0) & (row < high - low) & (column >= 0) & (column < grid.columns))
        neighbors[inside] += 1
        known_neighbors[inside] += is_known[row[inside], column[inside]]
    return labels.astype(np.int64) - 1, _Samples(positions, voids, neighbors, known_neighbors)


def _join(samples: _Samples, found: _Samples, first: int) -> _Samples:
    """Return open samples and those of the next band, whose voids count from `first`."""
    return _Samples(
        np.concatenate([samples.positions, found.positions]),
        np.concatenate([samples.voids, first + found.voids]),
        np.concatenate([samples.neighbors, found.neighbors]),
        np.concatenate([samples.known_neighbors, found.known_neighbors]),
    )


def _split(samples: _Samples) -> list[np.ndarray]:
    """Return the indices of samples of voids that are solved together, in ascending order."""
    sizes = np.bincount(samples.voids)
    parts = ((np.cumsum(sizes) - sizes) // SOLVED_SAMPLES)[samples.voids]
    return [np.flatnonzero(parts == part) for part in np.unique(parts)]


def _solve(grid: HeightGrid, positions: np.ndarray, voids: np.ndarray) -> np.ndarray:
    """Return the heights (N,) float64 in steps of all samples of `voids` (N,) at ascending `positions` (N,)."""
    centers = _with_neighbors(grid, positions)
    nodes = _with_neighbors(grid, centers)
    steps, is_known = _read_steps(grid, nodes)
    unknown = np.searchsorted(nodes, positions)
    owners = np.where(is_known, NO_VOID, OTHER_VOID)
    owners[unknown] = voids
    bending = _build_differences(grid, nodes, np.searchsorted(nodes, centers))
    members = owners[bending.indices]  # A center between two voids would make the one depend on the other.
    largest = np.maximum.reduceat(members, bending.indptr[:-1])
    is_mixed = np.logical_or.reduceat((members != NO_VOID) & (members != np.repeat(largest, np.diff(bending.indptr))), bending.indptr[:-1])
    bending = bending[~is_mixed]
    system = (1.0 - TENSION) * (bending[:, unknown].T @ bending) + TENSION * _build_links(grid, nodes, unknown)
    known = np.flatnonzero(owners == NO_VOID)
    center = steps[known].mean()
    factors = splu(system[:, unknown].tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return center - factors.solve(system[:, known] @ (steps[known] - center))


def _with_neighbors(grid: HeightGrid, positions: np.ndarray) -> np.ndarray:
    """Return ascending positions (N,) and those of their neighbors, ascending, each once."""
    rows, columns = np.divmod(positions, grid.columns)
    is_inside = (rows > 0, rows < grid.rows - 1, columns > 0, columns < grid.columns - 1)
    offsets = (-grid.columns, grid.columns, -1, 1)
    return np.unique(np.concatenate([positions, *(positions[inside] + offset for inside, offset in zip(is_inside, offsets, strict=True))]))


def _build_differences(grid: HeightGrid, nodes: np.ndarray, centers: np.ndarray) -> csr_array:
    """Return the sums (C, M) of the second differences along rows and columns at `centers` (C,), indices of `nodes` (M,). On the border of
    the grid, it is that along the border; corners have none."""
    rows, columns = np.divmod(nodes[centers], grid.columns)
    entries = []
    for is_between, offset in (((rows > 0) & (rows < grid.rows - 1), grid.columns), ((columns > 0) & (columns < grid.columns - 1), 1)):
        numbers = np.flatnonzero(is_between)
        for step, weight in ((-offset, -1.0), (0, 2.0), (offset, -1.0)):
            entries.append((np.full(len(numbers), weight), numbers, np.searchsorted(nodes, nodes[centers[numbers]] + step)))
    values, numbers, others = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    differences = csr_array((values, (numbers, others)), shape=(len(centers), len(nodes)))
    return differences[np.diff(differences.indptr) > 0]


def _build_links(grid: HeightGrid, nodes: np.ndarray, unknown: np.ndarray) -> csr_array:
    """Return the sums (N, M) of the differences to the neighbors at `unknown` (N,), indices of `nodes` (M,)."""
    rows, columns = np.divmod(nodes[unknown], grid.columns)
    entries = []
    for has_neighbor, offset in (
        (rows > 0, -grid.columns),
        (rows < grid.rows - 1, grid.columns),
        (columns > 0, -1),
        (columns < grid.columns - 1, 1),
    ):
        numbers = np.flatnonzero(has_neighbor)
        others = np.searchsorted(nodes, nodes[unknown[numbers]] + offset)
        entries += [(np.ones(len(numbers)), numbers, unknown[numbers]), (np.full(len(numbers), -1.0), numbers, others)]
    values, numbers, others = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return csr_array((values, (numbers, others)), shape=(len(unknown), len(nodes)))


def _read_steps(grid: HeightGrid, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights (N,) int64 in steps at ascending `positions` (N,), at least one, and which of them are known (N,)."""
    parts = [
        tuple(values.reshape(-1)[positions[members] - rows.start * grid.columns] for values in grid.read(rows, slice(0, grid.columns)))
        for members, rows in _split_by_bands(grid, positions)
    ]
    steps, is_known = (np.concatenate(part) for part in zip(*parts, strict=True))
    return steps.astype(np.int64), is_known


def _split_by_bands(grid: HeightGrid, positions: np.ndarray) -> Iterator[tuple[slice, slice]]:
    """Yield, for bands of a grid, the part of ascending `positions` (N,) that lies there and the rows of these."""
    if not len(positions):
        return
    for band in split_rows(int(positions[0]) // grid.columns, int(positions[-1]) // grid.columns + 1, grid.columns):
        first, last = np.searchsorted(positions, (band.start * grid.columns, band.stop * grid.columns))
        if first < last:
            yield slice(first, last), slice(int(positions[first]) // grid.columns, int(positions[last - 1]) // grid.columns + 1)


def _write_steps(grid: HeightGrid, positions: np.ndarray, steps: np.ndarray) -> None:
    """Write known heights (N,) in steps at ascending `positions` (N,) into the file of a grid."""
    values, dtype = encode_heights(steps, np.ones(len(steps), bool)), np.dtype("<i4")
    for members, rows in _split_by_bands(grid, positions):
        window = read_window(grid.path, dtype, grid.columns, rows, slice(0, grid.columns))
        window.reshape(-1)[positions[members] - rows.start * grid.columns] = values[members]
        with grid.path.open("r+b") as file:
            file.seek(rows.start * grid.columns * dtype.itemsize)
            file.write(window.tobytes())
