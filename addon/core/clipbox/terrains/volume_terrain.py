"""The terrain `volume`: a voxel model from a file.

The model is centered on x = y = 0 and stands on z = 0. Its longest side spans the source size times the scale. There is only air around it.
The surface lies at the mean of the smallest and the largest value.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...errors import FileError
from ...files.height_maps import CHUNK_SAMPLES, is_valid
from ...jobs.chunks import slices
from ..files.file_data import Voxels, min_max_valid
from ..files.readers import Readers, read_source
from ..settings import ClipboxSettings
from .grids import DensityFunction
from .pyramids import AxisSamples, build_pyramid, interpolate_axis, locate_samples, pyramid_level

MIN_VALUE_RANGE = 1e-30  # between values; single precision cannot represent less
MIN_CONTRAST = 0.05  # between a level's threshold and the surroundings, relative to that of level 0
MAX_SAMPLED_LAYERS = 32  # along each axis, for the mean gradient
AXIS_GRADIENT_FRACTION = 2.0 / 3.0  # mean gradient along the axes relative to the gradient, over uniformly distributed normals


@dataclass(frozen=True)
class VoxelModel:
    """The voxels of a file in scene units, centered on x = y = 0 and standing on z = 0.

    Attributes:
        levels: mean pyramid of the voxels, (X, Y, Z) each.
        voxel_sizes: (3,) float64, sides of a voxel of level 0.
        threshold: value at the surface.
        outside: value around the model.
        distance_per_value: scene units per unit of value.
    """

    levels: list[np.ndarray]
    voxel_sizes: np.ndarray
    threshold: float
    outside: float
    distance_per_value: float

    @property
    def extent(self) -> np.ndarray:
        """Size along each axis, (3,)."""
        return self.voxel_sizes * self.levels[0].shape

    @cached_property
    def level_thresholds(self) -> list[float]:
        """Values of the surface per level.

        They are lower where a level would otherwise have a smaller projected area along the axes than level 0, to preserve thin parts.
        """
        area = int((_maximum_projections(self.levels[0]) > self.threshold).sum())
        thresholds = [self.threshold]
        lowest = self.outside + MIN_CONTRAST * (self.threshold - self.outside)
        for level_index, level in enumerate(self.levels[1:], 1):
            values = np.sort(_maximum_projections(level))
            smallest_solid = values[-max(round(area / 4.0**level_index), 1)]
            below = values[: np.searchsorted(values, smallest_solid)]
            midpoint = 0.5 * float(smallest_solid + below[-1]) if len(below) else self.threshold
            thresholds.append(min(max(midpoint, lowest), self.threshold))
        return thresholds

    @cached_property
    def canopy_volume(self) -> float:
        """Volume below the surface that is visible from above, cubic scene units."""
        voxels = 0
        for layer in self.levels[0]:
            solid = layer > self.threshold
            voxels += int(np.where(solid.any(axis=1), solid.shape[1] - solid[:, ::-1].argmax(axis=1), 0).sum())
        return voxels * float(self.voxel_sizes.prod())

    def densities(self, coordinates: tuple[np.ndarray, np.ndarray, np.ndarray], voxel_size: float) -> np.ndarray:
        """Return values above the threshold, scaled to about the distance to the surface: (X, Y, Z) float32, trilinear between voxels.

        Args:
            coordinates: along each axis, scene units, in any order. voxel_size: distance between them; selects the pyramid level.
        """
        level_index = pyramid_level(voxel_size, math.prod(self.voxel_sizes.tolist()) ** (1.0 / 3.0), len(self.levels))
        level = self.levels[level_index]
        starts = (self.levels[0].shape[0] / 2.0, self.levels[0].shape[1] / 2.0, 0.0)
        samples = tuple(
            locate_samples((positions / size + start) / 2.0**level_index, -1, count)
            for positions, size, start, count in zip(coordinates, self.voxel_sizes, starts, level.shape, strict=True)
        )
        densities = _crop_or_pad(level, samples, self.outside)
        densities -= np.float32(self.level_thresholds[level_index])
        densities *= np.float32(self.distance_per_value)
        for axis in (2, 1, 0):
            densities = interpolate_axis(densities, samples[axis], axis)
        return densities


def build_volume(source: ClipboxSettings, readers: Readers) -> DensityFunction:
    """Return the densities of the voxel model in the source file.

    Raises:
        SettingsError, FileError: there is no file, or it has no voxels.
    """
    model = read_voxel_model(source, readers)
    return lambda grid: model.densities(tuple(grid.coordinates_along(axis) for axis in range(3)), grid.voxel_size)


def read_voxel_model(source: ClipboxSettings, readers: Readers) -> VoxelModel:
    """Read the voxel model in the source file.

    Raises:
        SettingsError, FileError: there is no file, or it has no voxels.
    """
    voxels = read_source(source.terrain, source.source, readers)
    if not isinstance(voxels, Voxels):
        raise FileError(f'"{source.source}" contains heights, not voxels; use the terrain "heights" for it.')
    spacing, outside, values = np.array(voxels.spacing), voxels.outside, np.ascontiguousarray(voxels.values)
    del voxels  # a model may fill half of the memory
    value_range = min_max_valid(values)
    if value_range is None:
        raise FileError(f'"{source.source}" contains no valid number.')
    smallest, largest = value_range
    if outside is None:
        outside = 0.0 if values.dtype == bool else smallest
    low, high = (0.0, 1.0) if values.dtype == bool else (min(smallest, outside), max(largest, outside))
    threshold = low + (high - low) / 2.0
    if largest - threshold < MIN_VALUE_RANGE:
        raise FileError(f'"{source.source}" has the same value everywhere, {smallest:g}; it contains no surface.')
    if values.dtype.itemsize > 2 or values.dtype.kind == "f":
        values, outside, threshold = _subtract_threshold(values, smallest, threshold), outside - threshold, 0.0
    voxel_sizes = spacing * (source.content_size * source.scale / (spacing * values.shape).max())
    distance_per_value = AXIS_GRADIENT_FRACTION / _mean_axis_gradient(values, voxel_sizes, threshold, high - low)
    return VoxelModel(build_pyramid(values, outside), voxel_sizes, threshold, outside, distance_per_value)


def _subtract_threshold(values: np.ndarray, smallest: float, threshold: float) -> np.ndarray:
    """Return `values` (X, Y, Z) minus `threshold` in single precision, subtracted before they are rounded. Overwrites single precision.

    Invalid numbers are replaced by the `smallest` valid one.
    """
    differences = values if values.dtype == np.float32 and values.flags.writeable else np.empty(values.shape, np.float32)
    flat, target = values.reshape(-1), differences.reshape(-1)
    for chunk in slices(flat.size, CHUNK_SAMPLES):
        numbers = flat[chunk].astype(np.float64)
        if values.dtype.kind == "f":
            numbers[~is_valid(flat[chunk])] = smallest
        numbers -= threshold
        target[chunk] = numbers
    return differences


def _maximum_projections(values: np.ndarray) -> np.ndarray:
    """Return the maximum along each line of voxels, for the lines along x, y and z one after the other."""
    return np.concatenate([values.max(axis=axis).ravel() for axis in range(3)])


def _mean_axis_gradient(values: np.ndarray, voxel_sizes: np.ndarray, threshold: float, value_range: float) -> float:
    """Return the mean change in value per scene unit between neighboring voxels on both sides of the surface.

    Where the surface lies only around the model, it is `value_range` per voxel.
    """
    total, count = 0.0, 0
    for axis, voxel_size in enumerate(voxel_sizes.tolist()):
        moved, layers = np.moveaxis(values, axis, 0), values.shape[axis]
        sampled = np.unique(np.linspace(0, layers - 2, min(layers - 1, MAX_SAMPLED_LAYERS)).astype(np.int64)) if layers > 1 else []
        for layer in sampled:
            below, above = moved[layer], moved[layer + 1]
            crossed = (below > threshold) != (above > threshold)
            total += float(np.abs(above[crossed].astype(np.float64) - below[crossed].astype(np.float64)).sum()) / voxel_size
            count += int(crossed.sum())
    return total / count if count else value_range / float(voxel_sizes.max())


def _crop_or_pad(level: np.ndarray, samples: tuple[AxisSamples, AxisSamples, AxisSamples], outside: float) -> np.ndarray:
    """Return the samples (X, Y, Z) float32 in the ranges of `samples`; those outside `level` are `outside`."""
    cropped = np.full([axis.stop - axis.start for axis in samples], outside, np.float32)
    spans = [(max(axis.start, 0), min(axis.stop, count)) for axis, count in zip(samples, level.shape, strict=True)]
    if all(low < high for low, high in spans):
        inside = level[tuple(slice(low, high) for low, high in spans)]
        cropped[tuple(slice(low - axis.start, high - axis.start) for (low, high), axis in zip(spans, samples, strict=True))] = inside
    return cropped
