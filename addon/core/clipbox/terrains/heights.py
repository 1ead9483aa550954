"""The terrain `heights`: a height map from a file as a volume that is solid below the ground.

The map is centered on x = y = 0, with north along y. Its longest side spans the source size times the scale. Outside the map the heights of
its edge continue. White in an image is as high as the source height times the scale. Elevations are true to scale: the lowest is at
z = 0, and one meter of height is as long as one meter along the ground.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...errors import FileError
from ...files.height_maps import CHUNK_SAMPLES
from ...jobs.chunks import slices
from ..files.file_data import HeightMap
from ..files.readers import Readers, read_source
from ..settings import ClipboxSettings
from .grids import Grid
from .pyramids import build_pyramid, interpolate_axis, locate_samples, pyramid_level


@dataclass(frozen=True, eq=False)
class GroundDensity:
    """Densities as the height of the ground minus z, in scene units. Heights are bilinear between pixel centers.

    Attributes:
        levels: mean pyramid of the heights, (W, H) float32 each, indexed by x and y.
        width, depth: sides of a pixel of level 0.
        warnings: sentences for the user.
    """

    levels: list[np.ndarray]
    width: float
    depth: float
    warnings: tuple[str, ...] = ()

    def __call__(self, grid: Grid) -> np.ndarray:
        """Return the densities (X, Y, Z) float32 of a grid."""
        columns, rows = self.levels[0].shape
        level_index = pyramid_level(grid.voxel_size, math.sqrt(self.width * self.depth), len(self.levels))
        level, factor = self.levels[level_index], 2.0**level_index
        along_x = locate_samples((grid.coordinates_along(0) / self.width + columns / 2.0) / factor, 0, level.shape[0] - 1)
        along_y = locate_samples((grid.coordinates_along(1) / self.depth + rows / 2.0) / factor, 0, level.shape[1] - 1)
        samples = level[along_x.start : along_x.stop, along_y.start : along_y.stop].astype(np.float64)
        heights = interpolate_axis(interpolate_axis(samples, along_y, 1), along_x, 0)
        values = np.empty(grid.shape, np.float32)
        return np.subtract(heights[:, :, None], grid.coordinates_along(2), out=values, dtype=np.float64, casting="same_kind")


def build_heights(source: ClipboxSettings, readers: Readers) -> GroundDensity:
    """Return the densities of the height map in the source file.

    Raises:
        SettingsError, FileError: there is no file, or it has no heights.
    """
    height_map = read_source(source.terrain, source.source, readers)
    if not isinstance(height_map, HeightMap):
        raise FileError(f'"{source.source}" contains voxels, not heights; use the terrain "volume" for it.')
    warnings = height_map.warnings
    ground, (width, depth) = _scale_to_scene(height_map, source)
    del height_map  # a map may fill half of the memory
    return GroundDensity(build_pyramid(ground, None), width, depth, warnings)


def _scale_to_scene(height_map: HeightMap, source: ClipboxSettings) -> tuple[np.ndarray, tuple[float, float]]:
    """Return heights (W, H) float32 indexed by x and y, and the width and depth of a pixel, all in scene units."""
    values, size = height_map.heights.T, source.source_size * source.scale
    width, depth = height_map.pixel_size or (1.0, 1.0)
    unit = size / max(values.shape[0] * width, values.shape[1] * depth)
    lowest = float(np.fmin.reduce(height_map.heights, axis=None))
    if math.isnan(lowest):
        raise FileError(f'"{source.source}" contains no valid height.')
    base, factor = (0.0, source.source_height * source.scale) if height_map.pixel_size is None else (lowest, unit)
    ground = np.empty(values.shape, np.float32)
    for chunk in slices(len(values), max(1, CHUNK_SAMPLES // values.shape[1])):
        heights = ground[chunk]
        np.subtract(values[chunk], base, out=heights, dtype=np.float64, casting="same_kind")
        heights *= np.float32(factor)
        heights[np.isnan(values[chunk])] = (lowest - base) * factor
    return ground, (width * unit, depth * unit)
