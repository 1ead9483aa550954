"""The terrain `heights`: a map of heights from a file as a volume, solid below the ground.

The map is centred on x = y = 0, north along y; its longest side spans the source size times the scale, and beyond its border the heights
of the edge go on. A picture's white is as high as the source height times the scale. Elevations are true to scale: the lowest lies at
z = 0, and a metre upwards is as long as a metre along the ground.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileError
from . import terrains
from .grids import Grid
from .pyramids import level_for, line_among, pyramid, swept
from .samples import HeightMap, check_size, is_number
from .sources import source_of

if TYPE_CHECKING:
    from .settings import ClipboxSettings

NO_DATA_INT16 = -32768  # what many programs write where they know no elevation, without saying so


def heights(settings: "ClipboxSettings") -> terrains.Densities:
    """The height of the ground less z, in scene units; between the centres of pixels the ground is bilinear.

    Raises:
        SettingsError, FileError: when there is no file, or none that gives heights.
    """
    source = source_of(settings)
    if not isinstance(source, HeightMap):
        raise FileError(f'"{settings.source}" holds voxels, not heights; choose the terrain "volume" for it.')
    ground, (width, depth) = _in_scene(source, settings)
    levels = pyramid(ground, None)
    columns, rows = ground.shape

    def densities(grid: Grid) -> np.ndarray:
        number = level_for(grid.voxel, math.sqrt(width * depth), len(levels))
        level, step = levels[number], 2.0**number
        along_x = line_among((grid.axis(0) / width + columns / 2.0) / step, 0, level.shape[0] - 1)
        along_y = line_among((grid.axis(1) / depth + rows / 2.0) / step, 0, level.shape[1] - 1)
        part = level[along_x.start : along_x.stop, along_y.start : along_y.stop].astype(np.float64)
        height = swept(swept(part, along_y, 1), along_x, 0)
        made = np.empty(grid.shape, np.float32)
        return np.subtract(height[:, :, None], grid.axis(2), out=made, dtype=np.float64, casting="same_kind")

    return densities


def _in_scene(source: HeightMap, settings: "ClipboxSettings") -> tuple[np.ndarray, tuple[float, float]]:
    """Heights (W, H) float32 by x and y, and the width and depth of a pixel; all in scene units."""
    values, span = source.heights.T, settings.source_size * settings.scale
    check_size(Path(settings.source), values.size, 4)
    width, depth = source.pixel or (1.0, 1.0)
    unit = span / max(values.shape[0] * width, values.shape[1] * depth)
    unknown = _unknown(source).T
    if unknown.all():
        raise FileError(f'"{settings.source}" holds no height anywhere.')
    lowest = float(values[~unknown].min())
    base, factor = (0.0, settings.source_height * settings.scale) if source.pixel is None else (lowest, unit)
    ground = np.empty(values.shape, np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # where nothing is known
        np.subtract(values, base, out=ground, dtype=np.float64, casting="same_kind")
        ground *= np.float32(factor)
    ground[unknown] = (lowest - base) * factor
    return ground, (width * unit, depth * unit)


def _unknown(source: HeightMap) -> np.ndarray:
    """Where (H, W) no height is known."""
    values = source.heights
    unknown = ~is_number(values)
    if source.no_data is not None:
        unknown |= values == source.no_data
    if values.dtype == np.int16:
        unknown |= values == NO_DATA_INT16
    return unknown


terrains.register("heights", "A map of heights from a file: a picture, a GeoTIFF or an array", heights)
