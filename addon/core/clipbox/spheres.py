"""Terrain carved out of spheres that are added and taken away, one after the other (section 3.3 of the paper), without bounds.

Spheres come in classes of size, each half as large as the last. Space is divided into cells, one lattice a class; the spheres of a cell
follow from its place and the seed, so none are stored and a grid costs only the ones that touch it. All of a class are worked in before the
next smaller class: first those that add, then those that take away; so it does not matter in which order they are found.
"""

from dataclasses import dataclass

import numpy as np

from .grids import Grid
from .hashing import fractions, hashed_lattice

AROUND = 1.01  # voxels beyond a sphere that still learn how far it is: those next to its surface
SMALLEST = 1.0  # voxels: spheres of a smaller diameter are left out
FAR = 1e4  # how far the nearest surface is where nothing is known
SMALL = 12  # voxels: spheres whose windows are no wider are worked in many at a time
PORTION = 1 << 15  # voxels of all their windows, which stay within the processor's cache


@dataclass(frozen=True)
class SphereField:
    """How spheres are strewn.

    largest: radius of the largest class, scene units. classes: how many. count: spheres a cell of four such radii a side. taken: share of
    the spheres that take away. height: centres of the largest class lie within this distance of z = 0, and no sphere reaches beyond what
    those reach.
    """

    largest: float
    classes: int
    count: int
    taken: float
    height: float
    seed: int


@dataclass(frozen=True)
class Spheres:
    """Centres (S, 3) float64, radii (S,) float64, which take away (S,) bool, in the order in which they count."""

    centres: np.ndarray
    radii: np.ndarray
    taken: np.ndarray


def spheres_touching(field: SphereField, grid: Grid) -> Spheres:
    """All spheres of `field` that reach into `grid`, largest class first, those that add before those that take away."""
    found = []
    for number in range(field.classes):
        radius = field.largest * 0.5**number
        if 2.0 * radius < SMALLEST * grid.voxel:
            break
        found.append(_of_class(field, number, radius, grid))
    parts = (
        [np.concatenate(part) for part in zip(*((each.centres, each.radii, each.taken) for each in found), strict=True)] if found else []
    )
    return Spheres(*parts) if parts else Spheres(np.empty((0, 3)), np.empty(0), np.empty(0, bool))


def _of_class(field: SphereField, number: int, radius: float, grid: Grid) -> Spheres:
    side, reach = 4.0 * radius, radius + AROUND * grid.voxel
    low = np.array(grid.origin) * grid.voxel
    high = (np.array(grid.origin) + grid.shape) * grid.voxel
    limit = field.height + field.largest - radius
    low[2], high[2] = max(low[2], -limit - radius), min(high[2], limit + radius)
    first, last = np.floor((low - reach) / side).astype(np.int64), np.floor((high + reach) / side).astype(np.int64)
    cells = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)), indexing="ij"), axis=-1).reshape(-1, 3)
    cells = np.repeat(cells, field.count, axis=0)
    bits = hashed_lattice(*cells.T, field.seed + 104729 * number)
    bits = bits + np.tile(np.arange(field.count, dtype=np.uint32) * np.uint32(0x632BE59B), len(cells) // field.count)
    centres = (cells + np.stack([fractions(bits, axis) for axis in range(3)], axis=1)) * side
    radii = radius * (0.5 + 0.5 * fractions(bits, 3))
    nearest = np.clip(centres, low, high)
    touching = (np.abs(centres - nearest).max(axis=1) <= radii + AROUND * grid.voxel) & (np.abs(centres[:, 2]) <= limit)
    taken = fractions(bits, 4) < field.taken
    order = np.concatenate([np.flatnonzero(touching & ~taken), np.flatnonzero(touching & taken)])
    return Spheres(centres[order], radii[order], taken[order])


def carved(grid: Grid, spheres: Spheres) -> np.ndarray:
    """Densities (X, Y, Z) float32 of the spheres one after the other: about the distance in scene units to the nearest surface, if near.

    A sphere of radius r about c gives (r^2 - |x - c|^2) / 2r, which is a sum of one term an axis, has the slope of the distance at the
    surface, and costs an addition and a comparison a voxel. Those of a run that add, or that take away, may come in any order.
    """
    densities = np.full(grid.shape, -FAR, np.float32)
    windows = _windows(grid, spheres)
    widths = (windows.stops - windows.starts).max(axis=1, initial=0)
    ends = np.flatnonzero(np.diff(spheres.taken[windows.rows])) + 1
    for run in np.split(np.arange(len(windows.rows)), ends):
        small = widths[run] <= SMALL
        for width in np.unique(widths[run][small]).tolist():
            _side_by_side(densities, grid, spheres, windows.some(run[widths[run] == width]), width)
        _one_by_one(densities, grid, spheres, windows.some(run[~small]))
    return densities


@dataclass(frozen=True)
class _Windows:
    """Which voxels spheres reach: rows (S,) of the spheres; starts, stops (S, 3) int64, voxels of the grid, which may lie beyond it."""

    rows: np.ndarray
    starts: np.ndarray
    stops: np.ndarray

    def some(self, which: np.ndarray) -> "_Windows":
        """Some of them."""
        return _Windows(self.rows[which], self.starts[which], self.stops[which])


def _windows(grid: Grid, spheres: Spheres) -> _Windows:
    """The windows of those spheres that reach into the grid."""
    reach = (spheres.radii + AROUND * grid.voxel)[:, None]
    starts = np.ceil((spheres.centres - reach) / grid.voxel - 0.5).astype(np.int64) - grid.origin
    stops = np.floor((spheres.centres + reach) / grid.voxel - 0.5).astype(np.int64) + 1 - grid.origin
    rows = np.flatnonzero(((stops > np.maximum(starts, 0)) & (starts < grid.shape)).all(axis=1))
    return _Windows(rows, starts[rows], stops[rows])


def _side_by_side(densities: np.ndarray, grid: Grid, spheres: Spheres, windows: _Windows, width: int) -> None:
    """Work in spheres whose windows are `width` voxels wide, all at once that do not touch each other: one by one they cost mostly
    beginnings."""
    shape = np.minimum(width, densities.shape)
    starts = np.clip(windows.starts, 0, densities.shape - shape)
    order, ends = _apart(starts // shape)
    starts, windows = starts[order], windows.some(order)
    x_terms, y_terms, z_terms = (_terms(grid, spheres, windows, axis, starts[:, axis], int(shape[axis])) for axis in range(3))
    cubes = np.lib.stride_tricks.sliding_window_view(densities, tuple(shape.tolist()), writeable=True)
    most = max(1, PORTION // int(shape.prod()))
    join = _joining(spheres, windows)
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        for first in range(start, end, most):
            some = slice(first, min(first + most, end))
            across = (y_terms[some, :, None] + z_terms[some, None, :]).reshape(-1, 1, int(shape[1] * shape[2]))
            values = (x_terms[some, :, None] + across).reshape(-1, *shape)
            places = tuple(starts[some].T)
            cubes[places] = join(cubes[places], values, out=values)


def _apart(cells: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """An order (S,) of windows that begin in `cells` (S, 3) as large as they are, and where in it each lot of them ends: those of a lot lie
    in cells that are even or odd alike, no two in the same, and so do not touch."""
    numbers = np.ravel_multi_index(tuple(cells.T), tuple((cells.max(axis=0) + 1).tolist()))
    by_cell = np.argsort(numbers, kind="stable")
    counts = np.bincount(numbers)
    counts = counts[counts > 0]
    turn = np.empty(len(cells), np.int64)
    turn[by_cell] = np.arange(len(cells)) - np.repeat(np.cumsum(counts) - counts, counts)
    lot = turn * 8 + (cells & 1) @ np.array([4, 2, 1])
    order = np.argsort(lot, kind="stable")
    return order, [*(np.flatnonzero(np.diff(lot[order])) + 1).tolist(), len(order)]


def _one_by_one(densities: np.ndarray, grid: Grid, spheres: Spheres, windows: _Windows) -> None:
    if len(windows.rows) == 0:
        return
    starts, stops = np.maximum(windows.starts, 0), np.minimum(windows.stops, densities.shape)
    widths = (stops - starts).max(axis=0).tolist()
    x_terms, y_terms, z_terms = (_terms(grid, spheres, windows, axis, starts[:, axis], widths[axis]) for axis in range(3))
    join = _joining(spheres, windows)
    for row, ((x0, y0, z0), (x1, y1, z1)) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
        part = densities[x0:x1, y0:y1, z0:z1]
        across = y_terms[row, : y1 - y0, None] + z_terms[row, : z1 - z0]
        join(part, x_terms[row, : x1 - x0, None, None] + across, out=part)


def _joining(spheres: Spheres, windows: _Windows) -> np.ufunc:
    """How the values of spheres that all add, or all take away, change densities."""
    return np.minimum if spheres.taken[windows.rows[0]] else np.maximum


def _terms(grid: Grid, spheres: Spheres, windows: _Windows, axis: int, starts: np.ndarray, width: int) -> np.ndarray:
    """What an axis adds to the values of spheres in `width` voxels from `starts` (S,) on: (S, width) float32, infinite beyond windows,
    with the sign that they count with."""
    centres, radii = spheres.centres[windows.rows, axis, None], spheres.radii[windows.rows, None]
    voxels = starts[:, None] + np.arange(width)
    places = (grid.origin[axis] + voxels + 0.5) * grid.voxel
    terms = ((radii**2 / 3.0 - (places - centres) ** 2) / (2.0 * radii)).astype(np.float32)
    terms[(voxels < windows.starts[:, axis, None]) | (voxels >= windows.stops[:, axis, None])] = -np.inf
    return np.negative(terms, out=terms) if spheres.taken[windows.rows[0]] else terms
