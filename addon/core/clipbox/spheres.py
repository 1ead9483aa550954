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
    surface, and costs an addition and a comparison a voxel.
    """
    densities = np.full(grid.shape, -FAR, np.float32)
    if len(spheres.radii) == 0:
        return densities
    starts, stops, terms = zip(*(_terms(grid, spheres, axis) for axis in range(3)), strict=True)
    starts, stops = np.stack(starts, axis=1), np.stack(stops, axis=1)
    inside = (stops > starts).all(axis=1)
    for index in np.flatnonzero(inside).tolist():
        (x0, y0, z0), (x1, y1, z1) = starts[index].tolist(), stops[index].tolist()
        part = densities[x0:x1, y0:y1, z0:z1]
        sphere = terms[0][index, : x1 - x0, None] + terms[1][index, : y1 - y0]
        sphere = sphere[:, :, None] + terms[2][index, : z1 - z0]
        if spheres.taken[index]:
            np.minimum(part, np.negative(sphere, out=sphere), out=part)
        else:
            np.maximum(part, sphere, out=part)
    return densities


def _terms(grid: Grid, spheres: Spheres, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The first voxel of each sphere along an axis, the one after its last, and the axis' terms from the first on, padded."""
    reach = spheres.radii + AROUND * grid.voxel
    centres = spheres.centres[:, axis]
    first = np.maximum(np.ceil((centres - reach) / grid.voxel - 0.5).astype(np.int64) - grid.origin[axis], 0)
    last = np.minimum(np.floor((centres + reach) / grid.voxel - 0.5).astype(np.int64) + 1 - grid.origin[axis], grid.shape[axis])
    longest = int(max((last - first).max(), 0))
    places = (grid.origin[axis] + first[:, None] + np.arange(longest) + 0.5) * grid.voxel
    terms = (spheres.radii[:, None] ** 2 / 3.0 - (places - centres[:, None]) ** 2) / (2.0 * spheres.radii[:, None])
    return first, last, terms.astype(np.float32)
