"""Unbounded terrain from spheres that are added and subtracted one after the other (section 3.3 of the paper).

Spheres come in size classes, each half as large as the last. Space is divided into cells, one lattice per class. The spheres of a cell are
hashed from its index and the seed, so nothing is stored and a grid only costs the spheres that touch it. All spheres of a class are applied
before the next smaller class, the additive ones before the subtractive ones, so the result does not depend on the order within a class.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import concatenate_ranges
from .grids import Grid
from .hashing import hash_lattice, uniform_random

SURFACE_MARGIN = 1.01  # voxels outside a sphere that still receive a distance: those next to its surface
MIN_DIAMETER = 1.0  # voxels; smaller spheres are left out
MAX_DISTANCE = 1e4  # distance to the surface, in scene units, where no sphere is near
MAX_BATCHED_WIDTH = 20  # voxels; spheres with windows of at most this width are applied in batches
MAX_CHUNK_VOXELS = 1 << 15  # voxels of all windows of a batch, which stay in the CPU cache


@dataclass(frozen=True)
class SphereField:
    """A random distribution of spheres.

    Attributes:
        max_radius: radius of the largest class, scene units.
        class_count: number of size classes.
        spheres_per_cell: spheres in a cell of side 4 radii.
        subtracted_fraction: fraction of the spheres that are subtracted.
        max_height: largest distance of centers of the largest class from z = 0. Smaller spheres extend no farther than the largest ones.
        seed: random seed.
    """

    max_radius: float
    class_count: int
    spheres_per_cell: int
    subtracted_fraction: float
    max_height: float
    seed: int


@dataclass(frozen=True)
class Spheres:
    """Spheres in the order in which they are applied: centers (S, 3) float64, radii (S,) float64, subtractive (S,) bool."""

    centers: np.ndarray
    radii: np.ndarray
    subtractive: np.ndarray


def find_touching_spheres(field: SphereField, grid: Grid) -> Spheres:
    """Return all spheres of `field` that overlap `grid`, largest class first, additive before subtractive."""
    classes = []
    for size_class in range(field.class_count):
        radius = field.max_radius * 0.5**size_class
        if 2.0 * radius < MIN_DIAMETER * grid.voxel_size:
            break
        classes.append(_find_spheres_of_class(field, size_class, radius, grid))
    if not classes:
        return Spheres(np.empty((0, 3)), np.empty(0), np.empty(0, bool))
    arrays = zip(*((spheres.centers, spheres.radii, spheres.subtractive) for spheres in classes), strict=True)
    return Spheres(*(np.concatenate(array) for array in arrays))


def _find_spheres_of_class(field: SphereField, size_class: int, radius: float, grid: Grid) -> Spheres:
    cell_size, margin = 4.0 * radius, radius + SURFACE_MARGIN * grid.voxel_size
    low = np.array(grid.origin) * grid.voxel_size
    high = (np.array(grid.origin) + grid.shape) * grid.voxel_size
    max_height = field.max_height + field.max_radius - radius
    low[2], high[2] = max(low[2], -max_height - radius), min(high[2], max_height + radius)
    first, last = np.floor((low - margin) / cell_size).astype(np.int64), np.floor((high + margin) / cell_size).astype(np.int64)
    cells = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)), indexing="ij"), axis=-1).reshape(-1, 3)
    cells = np.repeat(cells, field.spheres_per_cell, axis=0)
    bits = hash_lattice(*cells.T, field.seed + 104729 * size_class)
    within_cell = np.arange(field.spheres_per_cell, dtype=np.uint32) * np.uint32(0x632BE59B)
    bits = bits + np.tile(within_cell, len(cells) // field.spheres_per_cell)
    centers = (cells + np.stack([uniform_random(bits, axis) for axis in range(3)], axis=1)) * cell_size
    radii = radius * (0.5 + 0.5 * uniform_random(bits, 3))
    nearest = np.clip(centers, low, high)
    touching = np.abs(centers - nearest).max(axis=1) <= radii + SURFACE_MARGIN * grid.voxel_size
    touching &= np.abs(centers[:, 2]) <= max_height
    subtractive = uniform_random(bits, 4) < field.subtracted_fraction
    order = np.concatenate([np.flatnonzero(touching & ~subtractive), np.flatnonzero(touching & subtractive)])
    return Spheres(centers[order], radii[order], subtractive[order])


def csg_density(grid: Grid, spheres: Spheres) -> np.ndarray:
    """Return densities (X, Y, Z) float32 of a sequence of spheres: near the surface about the signed distance to it, in scene units.

    A sphere of radius r around c contributes (r^2 - |x - c|^2) / 2r. This is a sum of one term per axis, has the gradient of the distance
    at the surface, and costs one addition and one comparison per voxel. Within a run of additive or of subtractive spheres the order does
    not matter.
    """
    densities = np.full(grid.shape, -MAX_DISTANCE, np.float32)
    windows = _find_windows(grid, spheres)
    widths = (windows.stops - windows.starts).max(axis=1, initial=0)
    run_ends = np.flatnonzero(np.diff(spheres.subtractive[windows.spheres])) + 1
    for run in np.split(np.arange(len(windows.spheres)), run_ends):
        is_small = widths[run] <= MAX_BATCHED_WIDTH
        for width in np.unique(widths[run][is_small]).tolist():
            _apply_in_batches(densities, grid, spheres, windows.subset(run[widths[run] == width]), width)
        _apply_one_by_one(densities, grid, spheres, windows.subset(run[~is_small]))
    return densities


@dataclass(frozen=True)
class _Windows:
    """The voxels that spheres affect.

    spheres (S,): index of each sphere. starts, stops (S, 3) int64: voxel ranges relative to the grid; they may extend beyond it.
    """

    spheres: np.ndarray
    starts: np.ndarray
    stops: np.ndarray

    def subset(self, rows: np.ndarray) -> "_Windows":
        """Return the windows `rows`."""
        return _Windows(self.spheres[rows], self.starts[rows], self.stops[rows])


def _find_windows(grid: Grid, spheres: Spheres) -> _Windows:
    """Return the windows of the spheres that overlap the grid."""
    margins = (spheres.radii + SURFACE_MARGIN * grid.voxel_size)[:, None]
    starts = np.ceil((spheres.centers - margins) / grid.voxel_size - 0.5).astype(np.int64) - grid.origin
    stops = np.floor((spheres.centers + margins) / grid.voxel_size - 0.5).astype(np.int64) + 1 - grid.origin
    rows = np.flatnonzero(((stops > np.maximum(starts, 0)) & (starts < grid.shape)).all(axis=1))
    return _Windows(rows, starts[rows], stops[rows])


def _apply_in_batches(densities: np.ndarray, grid: Grid, spheres: Spheres, windows: _Windows, width: int) -> None:
    """Apply spheres whose windows are `width` voxels wide, in batches of disjoint windows: one by one they cost mostly call overhead."""
    shape = np.minimum(width, densities.shape)
    starts = np.clip(windows.starts, 0, densities.shape - shape)
    order, batch_ends = _conflict_free_batches(starts // shape)
    starts, windows = starts[order], windows.subset(order)
    x_terms, y_terms, z_terms = (_axis_terms(grid, spheres, windows, axis, starts[:, axis], int(shape[axis])) for axis in range(3))
    cubes = np.lib.stride_tricks.sliding_window_view(densities, tuple(shape.tolist()), writeable=True)
    chunk_size = max(1, MAX_CHUNK_VOXELS // int(shape.prod()))
    combine = _csg_operator(spheres, windows)
    for batch_start, batch_end in zip([0, *batch_ends[:-1]], batch_ends, strict=True):
        for first in range(batch_start, batch_end, chunk_size):
            rows = slice(first, min(first + chunk_size, batch_end))
            yz_terms = (y_terms[rows, :, None] + z_terms[rows, None, :]).reshape(-1, 1, int(shape[1] * shape[2]))
            values = (x_terms[rows, :, None] + yz_terms).reshape(-1, *shape)
            corners = tuple(starts[rows].T)
            cubes[corners] = combine(cubes[corners], values, out=values)


def _conflict_free_batches(cells: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Group windows into batches of disjoint windows.

    cells: (S, 3) cell in which each window begins; cells have the size of a window. The windows of a batch begin in different cells with
    the same parities, and therefore do not overlap.

    Returns the order (S,) of the windows, batch by batch, and the end of each batch in it.
    """
    cell_indices = np.ravel_multi_index(tuple(cells.T), tuple((cells.max(axis=0) + 1).tolist()))
    by_cell = np.argsort(cell_indices, kind="stable")
    counts = np.bincount(cell_indices)
    counts = counts[counts > 0]
    rank_in_cell = np.empty(len(cells), np.int64)
    rank_in_cell[by_cell] = concatenate_ranges(0, counts)
    batches = rank_in_cell * 8 + (cells & 1) @ np.array([4, 2, 1])
    order = np.argsort(batches, kind="stable")
    return order, [*(np.flatnonzero(np.diff(batches[order])) + 1).tolist(), len(order)]


def _apply_one_by_one(densities: np.ndarray, grid: Grid, spheres: Spheres, windows: _Windows) -> None:
    if len(windows.spheres) == 0:
        return
    starts, stops = np.maximum(windows.starts, 0), np.minimum(windows.stops, densities.shape)
    widths = (stops - starts).max(axis=0).tolist()
    x_terms, y_terms, z_terms = (_axis_terms(grid, spheres, windows, axis, starts[:, axis], widths[axis]) for axis in range(3))
    combine = _csg_operator(spheres, windows)
    for row, ((x0, y0, z0), (x1, y1, z1)) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
        window = densities[x0:x1, y0:y1, z0:z1]
        yz_terms = y_terms[row, : y1 - y0, None] + z_terms[row, : z1 - z0]
        combine(window, x_terms[row, : x1 - x0, None, None] + yz_terms, out=window)


def _csg_operator(spheres: Spheres, windows: _Windows) -> np.ufunc:
    """Return the ufunc that combines densities with those of spheres that are all additive or all subtractive."""
    return np.minimum if spheres.subtractive[windows.spheres[0]] else np.maximum


def _axis_terms(grid: Grid, spheres: Spheres, windows: _Windows, axis: int, starts: np.ndarray, width: int) -> np.ndarray:
    """Return the terms of one axis in the densities of spheres, in `width` voxels from `starts` (S,): (S, width) float32.

    Terms are infinite outside the windows and negated for subtractive spheres.
    """
    centers, radii = spheres.centers[windows.spheres, axis, None], spheres.radii[windows.spheres, None]
    voxels = starts[:, None] + np.arange(width)
    positions = (grid.origin[axis] + voxels + 0.5) * grid.voxel_size
    terms = ((radii**2 / 3.0 - (positions - centers) ** 2) / (2.0 * radii)).astype(np.float32)
    terms[(voxels < windows.starts[:, axis, None]) | (voxels >= windows.stops[:, axis, None])] = -np.inf
    return np.negative(terms, out=terms) if spheres.subtractive[windows.spheres[0]] else terms
