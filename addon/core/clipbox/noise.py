"""Gradient noise on regular grids and sums of it over octaves; value noise in the plane.

On a grid, the weights of the eight gradients about a point are products of three numbers that belong to one axis each. So the sums run
over one axis after the other: over the few lattice lines along z and y first, and only the last one over all voxels. Every value is worked
out by the same additions in the same order whatever grid it is part of, so slabs fit to the bit.
After Perlin, Improving Noise, 2002; ridges after Musgrave, Texturing and Modeling, 1994, chapter 16.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from ..parallel import slices
from .grids import Grid, blended
from .hashing import fractions, hashed_lattice

DIRECTIONS = 256  # that gradients have
FINEST = 4.0  # voxels: shorter waves than this cannot be shown; they stand with their mean
STEEPNESS = 1.6  # of the gradients: so noise comes near -1 and 1
CACHED = 1 << 14  # voxels that are summed at once
RIDGE_MEAN = 0.749  # of 1 - |noise|


@dataclass(frozen=True)
class _Line:
    """One axis of a grid among lattice points.

    points: (M,) int64 lattice points. first: (N,) int64 the point below each voxel. weights, slopes: (2, N) float32, what the point below
    and the one above add, for the two axes across and for the gradient along this axis.
    """

    points: np.ndarray
    first: np.ndarray
    weights: np.ndarray
    slopes: np.ndarray


def gradient_noise(grid: Grid, wavelength: float, seed: int, squash: float = 1.0) -> np.ndarray:
    """Noise (X, Y, Z) float32 about 0, hardly beyond -1 to 1; lattice points are `wavelength` apart, in z `squash` times closer."""
    along_x, along_y, along_z = (_line(grid.axis(axis) / (wavelength / (squash if axis == 2 else 1.0))) for axis in range(3))
    bits = hashed_lattice(along_x.points[:, None, None], along_y.points[:, None], along_z.points, seed) & np.uint32(DIRECTIONS - 1)
    in_x, in_y, in_z = (component[bits] for component in _gradients())
    swept = [_swept(each, along_z, 2, along_z.weights) for each in (in_x, in_y)] + [_swept(in_z, along_z, 2, along_z.slopes)]
    across = _swept(swept[1], along_y, 1, along_y.slopes) + _swept(swept[2], along_y, 1, along_y.weights)
    along = _swept(swept[0], along_y, 1, along_y.weights)
    return _last(across, along, along_x)


def _line(places: np.ndarray) -> _Line:
    """The weights of lattice points for rising `places` (N,), in units of the lattice."""
    first, fade = _among(places)
    points = np.arange(first[0], first[-1] + 2)
    if len(points) > 2 * len(places):  # voxels that pass over lattice points
        points = np.union1d(first, first + 1)
    part = places - first
    weights = np.stack([1.0 - fade, fade])
    slopes = weights * np.stack([part, part - 1.0])
    return _Line(points, np.searchsorted(points, first), weights.astype(np.float32), slopes.astype(np.float32))


def _swept(values: np.ndarray, line: _Line, axis: int, weights: np.ndarray) -> np.ndarray:
    """Sums over the lattice points of one axis: `values` has points along it, the result voxels."""
    return blended(values, line.first, line.first + 1, weights, axis)


def _last(across: np.ndarray, along: np.ndarray, line: _Line) -> np.ndarray:
    """The sum over the first axis, as many layers at a time as stay within the processor's cache."""
    made = np.empty((len(line.first), *across.shape[1:]), np.float32)
    for layers in slices(len(made), max(1, CACHED // made[0].size)):
        total, first = made[layers], line.first[layers]
        below = first if len(first) > 1 else int(first[0])  # of a single one no copy is made
        near, far = line.weights[:, layers, None, None]
        np.multiply(across[below], near, out=total)
        total += across[below + 1] * far
        near, far = line.slopes[:, layers, None, None]
        total += along[below] * near
        total += along[below + 1] * far
    return made


@cache
def _gradients() -> np.ndarray:
    """DIRECTIONS vectors as long as STEEPNESS, spread evenly over the sphere, in no order, as (3, DIRECTIONS) float32."""
    height = 1.0 - (2.0 * np.arange(DIRECTIONS) + 1.0) / DIRECTIONS
    turn = np.pi * (1.0 + 5.0**0.5) * np.arange(DIRECTIONS)
    radius = np.sqrt(1.0 - height**2)
    spread = STEEPNESS * np.stack([radius * np.cos(turn), radius * np.sin(turn), height]).astype(np.float32)
    return spread[:, np.random.default_rng(2002).permutation(DIRECTIONS)]


def value_noise(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """Smooth noise from -1 to 1, float64, at places whose shapes broadcast, in units of the lattice; its points have random values."""
    (left, across), (below, up) = (_among(each) for each in (x, y))
    corners = [[2.0 * fractions(hashed_lattice(left + i, below + j, np.int64(0), seed), 0) - 1.0 for j in (0, 1)] for i in (0, 1)]
    near, far = (first + (second - first) * up for first, second in corners)
    return near + (far - near) * across


def _among(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lattice points below places, and how far each is towards the next, smoothed so that slopes have no kinks."""
    below = np.floor(places)
    part = places - below
    return below.astype(np.int64), part**3 * (part * (part * 6.0 - 15.0) + 10.0)


def fractal(
    grid: Grid, wavelength: float, octaves: int, seed: int, *, gain: float = 0.5, ridged: bool = False, squash: float = 1.0
) -> np.ndarray:
    """Noise summed over octaves, each half as long and `gain` times as high as the last, (X, Y, Z) float32; the first has height 1.

    `ridged` turns each octave n into 1 - |n|, from 0 to 1. Octaves that the voxels cannot show stand with their mean.
    """
    total, height = np.zeros(grid.shape, np.float32), 1.0
    for octave in range(octaves):
        length = wavelength * 0.5**octave
        if length / squash < FINEST * grid.voxel:
            total += np.float32(RIDGE_MEAN * height if ridged else 0.0)
        else:
            noise = gradient_noise(grid, length, seed + 7919 * octave, squash)
            if ridged:
                np.abs(noise, out=noise)
                np.subtract(1.0, noise, out=noise)
            noise *= np.float32(height)
            total += noise
        height *= gain
    return total
