"""The terrain `heights`: a height map from a file as a volume that is solid below the ground.

The map is centered on x = y = 0, with north along y. Its longest side spans the source size times the scale. Outside the map the heights of
its edge continue. White in an image is as high as the source height times the scale. Elevations are true to scale: the lowest is at
z = 0, and one meter of height is as long as one meter along the ground.
"""

import math
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.height_maps import CHUNK_SAMPLES, HEIGHT_BYTES, check_size, find_missing
from ...jobs.chunks import slices
from ..files.file_data import HeightMap
from ..files.readers import Readers, read_source
from ..settings import ClipboxSettings
from .grids import DensityFunction, Grid
from .pyramids import build_pyramid, interpolate_axis, locate_samples, pyramid_level


def build_heights(source: ClipboxSettings, readers: Readers) -> DensityFunction:
    """Return densities as the height of the ground minus z, in scene units. Heights are bilinear between pixel centers.

    Raises:
        SettingsError, FileError: there is no file, or it has no heights.
    """
    height_map = read_source(source.terrain, source.source, readers)
    if not isinstance(height_map, HeightMap):
        raise FileError(f'"{source.source}" contains voxels, not heights; use the terrain "volume" for it.')
    ground, (width, depth) = _scale_to_scene(height_map, source)
    del height_map  # a map may fill half of the memory
    levels = build_pyramid(ground, None)
    columns, rows = ground.shape

    def densities(grid: Grid) -> np.ndarray:
        level_index = pyramid_level(grid.voxel_size, math.sqrt(width * depth), len(levels))
        level, factor = levels[level_index], 2.0**level_index
        along_x = locate_samples((grid.coordinates_along(0) / width + columns / 2.0) / factor, 0, level.shape[0] - 1)
        along_y = locate_samples((grid.coordinates_along(1) / depth + rows / 2.0) / factor, 0, level.shape[1] - 1)
        samples = level[along_x.start : along_x.stop, along_y.start : along_y.stop].astype(np.float64)
        heights = interpolate_axis(interpolate_axis(samples, along_y, 1), along_x, 0)
        values = np.empty(grid.shape, np.float32)
        return np.subtract(heights[:, :, None], grid.coordinates_along(2), out=values, dtype=np.float64, casting="same_kind")

    return densities


def _scale_to_scene(height_map: HeightMap, source: ClipboxSettings) -> tuple[np.ndarray, tuple[float, float]]:
    """Return heights (W, H) float32 indexed by x and y, and the width and depth of a pixel, all in scene units."""
    values, size = height_map.heights.T, source.source_size * source.scale
    check_size(Path(source.source), values.size, HEIGHT_BYTES)
    width, depth = height_map.pixel_size or (1.0, 1.0)
    unit = size / max(values.shape[0] * width, values.shape[1] * depth)
    columns = slices(len(values), max(1, CHUNK_SAMPLES // values.shape[1]))
    smallest = [float(known.min()) for chunk in columns if (known := values[chunk][~find_missing(values[chunk], height_map.no_data)]).size]
    if not smallest:
        raise FileError(f'"{source.source}" contains no valid height.')
    lowest = min(smallest)
    base, factor = (0.0, source.source_height * source.scale) if height_map.pixel_size is None else (lowest, unit)
    ground = np.empty(values.shape, np.float32)
    for chunk in columns:
        heights = ground[chunk]
        with np.errstate(over="ignore", invalid="ignore"):  # Missing heights are replaced below.
            np.subtract(values[chunk], base, out=heights, dtype=np.float64, casting="same_kind")
            heights *= np.float32(factor)
        heights[find_missing(values[chunk], height_map.no_data)] = (lowest - base) * factor
    return ground, (width * unit, depth * unit)
