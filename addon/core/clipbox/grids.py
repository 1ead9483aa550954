"""Regular grids of voxels in terrain space: where terrains are asked for their densities."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Grid:
    """The voxels `origin` to `origin + shape` of a lattice, in whole voxels; voxel i reaches from i to i + 1 times `voxel` scene units."""

    origin: tuple[int, int, int]
    shape: tuple[int, int, int]
    voxel: float

    def axis(self, axis: int) -> np.ndarray:
        """Coordinates (n,) float64 of the voxels' centres along one axis, in scene units."""
        return (np.arange(self.origin[axis], self.origin[axis] + self.shape[axis], dtype=np.int64) + 0.5) * self.voxel

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates along x (X, 1, 1), y (1, Y, 1) and z (1, 1, Z), which broadcast to the grid."""
        return self.axis(0)[:, None, None], self.axis(1)[None, :, None], self.axis(2)[None, None, :]

    def layers(self, count: int) -> list["Grid"]:
        """The grid in slices of at most `count` voxels along x."""
        first, size = self.origin[0], self.shape[0]
        starts = range(0, size, count)
        return [Grid((first + at, *self.origin[1:]), (min(count, size - at), *self.shape[1:]), self.voxel) for at in starts]


def blended(values: np.ndarray, below: np.ndarray, above: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
    """Sums along one axis of what `values` hold at `below` and `above` (N,) times `weights` (2, N): each alike in every part."""
    shape = [1] * values.ndim
    shape[axis] = -1
    first, second = values.take(below, axis), values.take(above, axis)
    first *= weights[0].reshape(shape)
    second *= weights[1].reshape(shape)
    first += second
    return first
