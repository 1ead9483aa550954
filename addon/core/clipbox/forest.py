"""The terrain `forest`: copies of the voxels of a file, strewn over hills (the paper's Figure 19, where they are a tree).

The plane is divided into cells; where in its cell a copy stands, how large it is and how it is turned follow from the place of the cell and
the seed, so none are stored and a grid costs only the copies that touch it. Where voxels are too large for copies, the ground is as much
higher as what is seen of them from above.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import terrains
from .grids import Grid
from .hashing import fractions, hashed_lattice
from .noise import FINEST, value_noise
from .voxels import VoxelBlock, block_of

if TYPE_CHECKING:
    from .settings import ClipboxSettings

SMALLEST = 0.6  # size of the smallest copy, of the largest's
MEAN_CUBE = (1.0 - SMALLEST**4) / (4.0 * (1.0 - SMALLEST))  # of the sizes
BORDER = 0.2  # of a cell, in which no copy has its middle
STEEPNESS = 12.0  # heights of a hill that the longest wave is long
OCTAVES = 3
LEAST_VOXELS = 3.0  # of the largest copy along its longest side: with fewer, they raise the ground


@dataclass(frozen=True)
class _Copies:
    """Where copies stand: feet (C, 3) float64 scene units. sizes (C,) of the block's. turned (C,): whether x and y change places. signs
    (C, 2): -1 where the block's x or y runs backwards."""

    feet: np.ndarray
    sizes: np.ndarray
    turned: np.ndarray
    signs: np.ndarray


@dataclass(frozen=True)
class Forest:
    """block: what stands there. spacing: side of a cell. hills: how far the ground rises and falls; both in scene units."""

    block: VoxelBlock
    spacing: float
    hills: float
    seed: int

    def densities(self, grid: Grid) -> np.ndarray:
        """About the distance to the surface (X, Y, Z) float32, scene units."""
        x, y, z = grid.axes()
        height = self.heights(x[:, :, 0], y[:, :, 0], FINEST * grid.voxel)
        as_copies = self.block.extent.max() >= LEAST_VOXELS * grid.voxel
        if not as_copies:
            height += MEAN_CUBE * self.block.canopy / self.spacing**2
        made = np.empty(grid.shape, np.float32)
        np.subtract(height[:, :, None], z, out=made, dtype=np.float64, casting="same_kind")
        if as_copies:
            self._set(made, grid)
        return made

    def heights(self, x: np.ndarray, y: np.ndarray, finest: float = 0.0) -> np.ndarray:
        """Heights of the ground, scene units, at places whose shapes broadcast, without waves that are shorter than `finest`."""
        total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
        for octave in range(OCTAVES if self.hills else 0):
            length = STEEPNESS * self.hills * 0.5**octave
            if length >= finest:
                total += self.hills * 0.5 ** (octave + 1) * value_noise(x / length, y / length, self.seed + octave)
        return total

    def copies_about(self, grid: Grid) -> _Copies:
        """All copies that may reach into a grid, by their cells."""
        reach = 0.5 * float(self.block.extent[:2].max()) + 2.0 * grid.voxel
        spans = []
        for axis in range(2):
            along = grid.axis(axis)
            first, last = np.floor((along[0] - reach) / self.spacing), np.floor((along[-1] + reach) / self.spacing)
            spans.append(np.arange(int(first), int(last) + 1))
        cells = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 2)
        bits = hashed_lattice(cells[:, 0], cells[:, 1], np.zeros(len(cells), np.int64), self.seed + 31)
        within = np.stack([fractions(bits, 0), fractions(bits, 1)], axis=1)
        x, y = ((cells + BORDER + (1.0 - 2.0 * BORDER) * within) * self.spacing).T
        sizes = SMALLEST + (1.0 - SMALLEST) * fractions(bits, 2)
        signs = np.where(np.stack([fractions(bits, 3), fractions(bits, 4)], axis=1) < 0.5, -1.0, 1.0)
        return _Copies(np.stack([x, y, self.heights(x, y)], axis=1), sizes, fractions(bits, 5) < 0.5, signs)

    def _set(self, made: np.ndarray, grid: Grid) -> None:
        """Let `made` have the copies that reach into a grid."""
        copies, extent = self.copies_about(grid), self.block.extent
        axes = [grid.axis(axis) for axis in range(3)]
        for foot, size, turned, signs in zip(copies.feet, copies.sizes.tolist(), copies.turned.tolist(), copies.signs, strict=True):
            sides = size * (extent[[1, 0, 2]] if turned else extent)
            low = foot - sides * np.array([0.5, 0.5, 0.0]) - grid.voxel
            high = foot + sides * np.array([0.5, 0.5, 1.0]) + grid.voxel
            spans = [slice(*np.searchsorted(along, (a, b)).tolist()) for along, a, b in zip(axes, low, high, strict=True)]
            if any(span.start >= span.stop for span in spans):
                continue
            x, y, z = ((along[span] - at) / size for along, span, at in zip(axes, spans, foot, strict=True))
            local = (signs[0] * y, signs[1] * x, z) if turned else (signs[0] * x, signs[1] * y, z)
            values = self.block.densities(local, grid.voxel / size)
            values *= np.float32(size)
            part = made[tuple(spans)]
            np.maximum(part, values.swapaxes(0, 1) if turned else values, out=part)


def forest(settings: "ClipboxSettings") -> terrains.Densities:
    """A forest of the block of a file.

    Raises:
        SettingsError, FileError: when there is no file, or none that gives voxels.
    """
    block = block_of(settings)
    spacing = settings.forest_spacing * settings.source_size * settings.scale
    return Forest(block, spacing, settings.forest_hills * settings.scale, settings.seed).densities


terrains.register("forest", "Copies of the voxels of a file, strewn over hills", forest)
