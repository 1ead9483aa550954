"""The terrain `forest`: copies of a voxel model from a file, scattered over hills (Figure 19 of the paper, where they are trees).

The plane is divided into cells. The position, scale and rotation of the copy in a cell are hashed from the cell's index and the seed, so
nothing is stored and a grid only costs the copies that touch it. Where voxels are too large to resolve copies, the ground is raised by the
mean canopy volume per area instead.
"""

from dataclasses import dataclass

import numpy as np

from ..files.readers import Readers
from ..settings import ClipboxSettings
from .grids import DensityFunction, Grid
from .hashing import hash_lattice, uniform_random
from .noise import MIN_WAVELENGTH, value_noise
from .volume_terrain import VoxelModel, read_voxel_model

MIN_SCALE = 0.6  # scale of the smallest copies; the largest have scale 1
MEAN_CUBED_SCALE = (1.0 - MIN_SCALE**4) / (4.0 * (1.0 - MIN_SCALE))
CELL_MARGIN = 0.2  # fraction of a cell along its boundary that contains no copy's center
WAVELENGTH_PER_HEIGHT = 12.0  # wavelength of the longest octave of the hills relative to their height
OCTAVES = 3
MIN_MODEL_VOXELS = 3.0  # along the longest side of the largest copy; if smaller, copies only raise the ground


@dataclass(frozen=True)
class _Copies:
    """Transforms of copies.

    Attributes:
        positions: (C, 3) float64, centers of the base, scene units.
        scales: (C,) float64.
        transposed: (C,) bool, whether x and y are swapped.
        signs: (C, 2) float64, -1 where the model's x or y axis is mirrored.
    """

    positions: np.ndarray
    scales: np.ndarray
    transposed: np.ndarray
    signs: np.ndarray


@dataclass(frozen=True)
class Forest:
    """Copies of `model` on hills. spacing: side of a cell. hills: height range of the ground. Both in scene units."""

    model: VoxelModel
    spacing: float
    hills: float
    seed: int

    def densities(self, grid: Grid) -> np.ndarray:
        """Return about the distance to the surface (X, Y, Z) float32, scene units."""
        x, y, z = grid.coordinates()
        heights = self.ground_heights(x[:, :, 0], y[:, :, 0], MIN_WAVELENGTH * grid.voxel_size)
        resolves_copies = self.model.extent.max() >= MIN_MODEL_VOXELS * grid.voxel_size
        if not resolves_copies:
            heights += MEAN_CUBED_SCALE * self.model.canopy_volume / self.spacing**2
        densities = np.empty(grid.shape, np.float32)
        np.subtract(heights[:, :, None], z, out=densities, dtype=np.float64, casting="same_kind")
        if resolves_copies:
            self._add_copies(densities, grid)
        return densities

    def ground_heights(self, x: np.ndarray, y: np.ndarray, min_wavelength: float = 0.0) -> np.ndarray:
        """Return heights of the ground, scene units, at positions whose shapes broadcast, without octaves below `min_wavelength`."""
        total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
        for octave in range(OCTAVES if self.hills else 0):
            wavelength = WAVELENGTH_PER_HEIGHT * self.hills * 0.5**octave
            if wavelength >= min_wavelength:
                total += self.hills * 0.5 ** (octave + 1) * value_noise(x / wavelength, y / wavelength, self.seed + octave)
        return total

    def find_copies(self, grid: Grid) -> _Copies:
        """Return all copies that may overlap a grid, in the order of their cells."""
        margin = 0.5 * float(self.model.extent[:2].max()) + 2.0 * grid.voxel_size
        spans = []
        for axis in range(2):
            coordinates = grid.coordinates_along(axis)
            first, last = np.floor((coordinates[0] - margin) / self.spacing), np.floor((coordinates[-1] + margin) / self.spacing)
            spans.append(np.arange(int(first), int(last) + 1))
        cells = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 2)
        bits = hash_lattice(cells[:, 0], cells[:, 1], np.zeros(len(cells), np.int64), self.seed + 31)
        within_cell = np.stack([uniform_random(bits, 0), uniform_random(bits, 1)], axis=1)
        x, y = ((cells + CELL_MARGIN + (1.0 - 2.0 * CELL_MARGIN) * within_cell) * self.spacing).T
        scales = MIN_SCALE + (1.0 - MIN_SCALE) * uniform_random(bits, 2)
        signs = np.where(np.stack([uniform_random(bits, 3), uniform_random(bits, 4)], axis=1) < 0.5, -1.0, 1.0)
        return _Copies(np.stack([x, y, self.ground_heights(x, y)], axis=1), scales, uniform_random(bits, 5) < 0.5, signs)

    def _add_copies(self, densities: np.ndarray, grid: Grid) -> None:
        """Add the copies that overlap a grid to its `densities`."""
        copies, extent = self.find_copies(grid), self.model.extent
        axes = [grid.coordinates_along(axis) for axis in range(3)]
        for position, scale, transposed, signs in zip(
            copies.positions, copies.scales.tolist(), copies.transposed.tolist(), copies.signs, strict=True
        ):
            size = scale * (extent[[1, 0, 2]] if transposed else extent)
            low = position - size * np.array([0.5, 0.5, 0.0]) - grid.voxel_size
            high = position + size * np.array([0.5, 0.5, 1.0]) + grid.voxel_size
            spans = [slice(*np.searchsorted(axis, (a, b)).tolist()) for axis, a, b in zip(axes, low, high, strict=True)]
            if any(span.start >= span.stop for span in spans):
                continue
            x, y, z = ((axis[span] - center) / scale for axis, span, center in zip(axes, spans, position, strict=True))
            local = (signs[0] * y, signs[1] * x, z) if transposed else (signs[0] * x, signs[1] * y, z)
            values = self.model.densities(local, grid.voxel_size / scale)
            values *= np.float32(scale)
            window = densities[tuple(spans)]
            np.maximum(window, values.swapaxes(0, 1) if transposed else values, out=window)


def build_forest(source: ClipboxSettings, readers: Readers) -> DensityFunction:
    """Return the densities of a forest of the voxel model in the source file.

    Raises:
        SettingsError, FileError: there is no file, or it has no voxels.
    """
    model = read_voxel_model(source, readers)
    spacing = source.forest_spacing * source.plant_size * source.scale
    return Forest(model, spacing, source.forest_hills * source.scale, source.seed).densities
