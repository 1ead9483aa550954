"""Regular voxel grids in terrain space, at which terrains are sampled."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Grid:
    """The voxels `origin` to `origin + shape` of a lattice, in voxel indices. Voxel i spans i to i + 1 times `voxel_size` scene units."""

    origin: tuple[int, int, int]
    shape: tuple[int, int, int]
    voxel_size: float

    def coordinates_along(self, axis: int) -> np.ndarray:
        """Return the coordinates (n,) float64 of the voxel centers along one axis, in scene units."""
        return (np.arange(self.origin[axis], self.origin[axis] + self.shape[axis], dtype=np.int64) + 0.5) * self.voxel_size

    def coordinates(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the coordinates along x (X, 1, 1), y (1, Y, 1) and z (1, 1, Z), which broadcast to the grid."""
        return self.coordinates_along(0)[:, None, None], self.coordinates_along(1)[None, :, None], self.coordinates_along(2)[None, None, :]

    def slabs(self, thickness: int) -> list["Grid"]:
        """Split the grid into slabs of at most `thickness` voxels along x."""
        first, size = self.origin[0], self.shape[0]
        starts = range(0, size, thickness)
        return [
            Grid((first + start, *self.origin[1:]), (min(thickness, size - start), *self.shape[1:]), self.voxel_size) for start in starts
        ]


DensityFunction = Callable[[Grid], np.ndarray]  # densities that broadcast to the grid's shape, positive where solid


def lerp_axis(values: np.ndarray, below: np.ndarray, above: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
    """Return weighted sums of two samples along one axis: values[below] * weights[0] + values[above] * weights[1].

    Every result is computed in the same order, whichever part of an array it belongs to.

    Args:
        values: floating-point array. below, above: (N,) indices along `axis`. weights: (2, N) of the type of `values`.
    """
    shape = [1] * values.ndim
    shape[axis] = -1
    result, upper = values.take(below, axis), values.take(above, axis)
    result *= weights[0].reshape(shape)
    upper *= weights[1].reshape(shape)
    result += upper
    return result


def smooth_minimum(first: np.ndarray, second: np.ndarray, width: np.float32) -> np.ndarray:
    """Return the polynomial smooth minimum of two densities, which blends where they differ by less than `width`.

    It rounds off the edges between them, which would show as jagged lines in voxels.
    """
    blend = np.abs(first - second)
    np.subtract(width, blend, out=blend)
    np.maximum(blend, np.float32(0.0), out=blend)
    blend *= blend
    blend /= 4.0 * width
    minimum = np.minimum(first, second)
    minimum -= blend
    return minimum
