"""Gradient noise on regular grids, its sum over octaves (fBm), and value noise in the plane.

On a grid, the weights of the eight lattice gradients around a point are products of one factor per axis. The sum therefore runs over one
axis after the other: over the few lattice lines along z and y first, and only the last one over all voxels. Every value is computed by the
same additions in the same order, whichever grid it belongs to, so adjacent slabs match to the bit.
After Perlin, Improving Noise, 2002; ridged noise after Musgrave, Texturing and Modeling, 1994, chapter 16.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from ...jobs.chunks import slices
from .grids import Grid, lerp_axis
from .hashing import hash_lattice, uniform_random

GRADIENT_COUNT = 256
MIN_WAVELENGTH = 4.0  # voxels; shorter octaves cannot be resolved and are replaced by their mean
GRADIENT_LENGTH = 1.6  # scales the noise to about -1 to 1
MAX_CHUNK_VOXELS = 1 << 14  # voxels that are summed at once, so that they stay in the CPU cache
MEAN_RIDGED_NOISE = 0.749  # mean of 1 - |noise|


@dataclass(frozen=True)
class _LatticeAxis:
    """One axis of a grid relative to the lattice.

    points: (M,) int64 lattice points. first: (N,) int64 index of the lattice point below each voxel. weights: (2, N) float32 of the lattice
    points below and above. gradient_weights: (2, N) float32, the weights times the distance from the lattice point along this axis.
    """

    points: np.ndarray
    first: np.ndarray
    weights: np.ndarray
    gradient_weights: np.ndarray


def gradient_noise(grid: Grid, wavelength: float, seed: int, squash: float = 1.0) -> np.ndarray:
    """Return noise (X, Y, Z) float32 with mean 0, mostly within -1 to 1.

    Lattice points are `wavelength` scene units apart, along z `squash` times closer.
    """
    x, y, z = (_locate_on_lattice(grid.coordinates_along(axis) / (wavelength / (squash if axis == 2 else 1.0))) for axis in range(3))
    bits = hash_lattice(x.points[:, None, None], y.points[:, None], z.points, seed) & np.uint32(GRADIENT_COUNT - 1)
    gradient_x, gradient_y, gradient_z = (component[bits] for component in _gradient_table())
    along_z = [_interpolate_axis(component, z, 2, z.weights) for component in (gradient_x, gradient_y)]
    along_z.append(_interpolate_axis(gradient_z, z, 2, z.gradient_weights))
    sum_yz = _interpolate_axis(along_z[1], y, 1, y.gradient_weights) + _interpolate_axis(along_z[2], y, 1, y.weights)
    sum_x = _interpolate_axis(along_z[0], y, 1, y.weights)
    return _interpolate_x(sum_yz, sum_x, x)


def _locate_on_lattice(positions: np.ndarray) -> _LatticeAxis:
    """Compute the weights of lattice points for ascending `positions` (N,), in lattice units."""
    first, t = _lattice_cells(positions)
    points = np.arange(first[0], first[-1] + 2)
    if len(points) > 2 * len(positions):  # voxels larger than lattice cells skip lattice points
        points = np.union1d(first, first + 1)
    distance = positions - first
    weights = np.stack([1.0 - t, t])
    gradient_weights = weights * np.stack([distance, distance - 1.0])
    return _LatticeAxis(points, np.searchsorted(points, first), weights.astype(np.float32), gradient_weights.astype(np.float32))


def _interpolate_axis(values: np.ndarray, lattice: _LatticeAxis, axis: int, weights: np.ndarray) -> np.ndarray:
    """Return sums over the lattice points of one axis: `values` has lattice points along it, the result has voxels."""
    return lerp_axis(values, lattice.first, lattice.first + 1, weights, axis)


def _interpolate_x(sum_yz: np.ndarray, sum_x: np.ndarray, lattice: _LatticeAxis) -> np.ndarray:
    """Return the sum over the x axis of the y and z components, `sum_yz`, and of the x component, `sum_x`.

    Processes as many layers at a time as stay within the CPU cache.
    """
    noise = np.empty((len(lattice.first), *sum_yz.shape[1:]), np.float32)
    for layers in slices(len(noise), max(1, MAX_CHUNK_VOXELS // noise[0].size)):
        total, first = noise[layers], lattice.first[layers]
        below = first if len(first) > 1 else int(first[0])  # an integer index makes a view instead of a copy
        lower, upper = lattice.weights[:, layers, None, None]
        np.multiply(sum_yz[below], lower, out=total)
        total += sum_yz[below + 1] * upper
        lower, upper = lattice.gradient_weights[:, layers, None, None]
        total += sum_x[below] * lower
        total += sum_x[below + 1] * upper
    return noise


@cache
def _gradient_table() -> np.ndarray:
    """Return evenly distributed vectors of length GRADIENT_LENGTH in random order, (3, GRADIENT_COUNT) float32."""
    height = 1.0 - (2.0 * np.arange(GRADIENT_COUNT) + 1.0) / GRADIENT_COUNT
    angle = np.pi * (1.0 + 5.0**0.5) * np.arange(GRADIENT_COUNT)
    radius = np.sqrt(1.0 - height**2)
    vectors = GRADIENT_LENGTH * np.stack([radius * np.cos(angle), radius * np.sin(angle), height]).astype(np.float32)
    return vectors[:, np.random.default_rng(2002).permutation(GRADIENT_COUNT)]


def value_noise(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """Return smooth noise from -1 to 1, float64, interpolated between random values at lattice points.

    x, y: positions in lattice units, whose shapes broadcast.
    """
    (left, t_x), (below, t_y) = (_lattice_cells(positions) for positions in (x, y))
    corners = [[2.0 * uniform_random(hash_lattice(left + i, below + j, np.int64(0), seed), 0) - 1.0 for j in (0, 1)] for i in (0, 1)]
    at_left, at_right = (bottom + (top - bottom) * t_y for bottom, top in corners)
    return at_left + (at_right - at_left) * t_x


def _lattice_cells(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lattice points below `positions`, and interpolation factors with continuous second derivatives."""
    below = np.floor(positions)
    distance = positions - below
    return below.astype(np.int64), distance**3 * (distance * (distance * 6.0 - 15.0) + 10.0)


def fbm(
    grid: Grid, wavelength: float, octaves: int, seed: int, *, gain: float = 0.5, ridged: bool = False, squash: float = 1.0
) -> np.ndarray:
    """Return fractional Brownian motion (X, Y, Z) float32: octaves of noise, each with half the wavelength of the last.

    The first octave has amplitude 1, each further one `gain` times the last. `ridged` turns each octave n into 1 - |n|, from 0 to 1.
    Octaves that the voxels cannot resolve are replaced by their mean.
    """
    total, amplitude = np.zeros(grid.shape, np.float32), 1.0
    for octave in range(octaves):
        octave_wavelength = wavelength * 0.5**octave
        if octave_wavelength / squash < MIN_WAVELENGTH * grid.voxel_size:
            total += np.float32(MEAN_RIDGED_NOISE * amplitude if ridged else 0.0)
        else:
            noise = gradient_noise(grid, octave_wavelength, seed + 7919 * octave, squash)
            if ridged:
                np.abs(noise, out=noise)
                np.subtract(1.0, noise, out=noise)
            noise *= np.float32(amplitude)
            total += noise
        amplitude *= gain
    return total
