"""The terrain `volume`: a block of voxels from a file.

The block is centred on x = y = 0 and stands on z = 0; its longest side spans the source size times the scale, and around it nothing is
solid. The ground begins in the middle between the smallest and the largest value.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileError
from . import terrains
from .pyramids import Line, level_for, line_among, pyramid, swept
from .samples import Voxels, is_number
from .sources import source_of

if TYPE_CHECKING:
    from .settings import ClipboxSettings

LEAST_STEP = 1e-30  # between values, or single precision ends
LEAST_CONTRAST = 0.05  # of the difference between the surface and what is around, below which a surface is lost in it
LAYERS_LOOKED_AT = 32  # along each axis, for the slope
SEEN_ALONG_AXES = 2.0 / 3.0  # of the slope, the mean over surfaces that face all ways alike


@dataclass(frozen=True)
class VoxelBlock:
    """The voxels of a file in scene units, centred on x = y = 0 and standing on z = 0.

    levels: the voxels and their averages, (X, Y, Z). sides: (3,) of a voxel of the first. threshold: the value of the surface. outside:
    the value around. factor: the distance that a step of one in value stands for.
    """

    levels: list[np.ndarray]
    sides: np.ndarray
    threshold: float
    outside: float
    factor: float

    @property
    def extent(self) -> np.ndarray:
        """How far it reaches along each axis, (3,)."""
        return self.sides * self.levels[0].shape

    @cached_property
    def thresholds(self) -> list[float]:
        """The values of the surface at each level: lower where less would be seen of it along the axes than of the first."""
        seen, found = int((_largest_along_axes(self.levels[0]) > self.threshold).sum()), [self.threshold]
        least = self.outside + LEAST_CONTRAST * (self.threshold - self.outside)
        for number, level in enumerate(self.levels[1:], 1):
            values = np.sort(_largest_along_axes(level))
            last = values[-max(round(seen / 4.0**number), 1)]  # of those that are to be seen
            below = values[: np.searchsorted(values, last)]
            between = 0.5 * float(last + below[-1]) if len(below) else self.threshold
            found.append(min(max(between, least), self.threshold))
        return found

    @cached_property
    def canopy(self) -> float:
        """The volume below what is seen of it from above, cubic scene units."""
        voxels = 0
        for layer in self.levels[0]:
            solid = layer > self.threshold
            voxels += int(np.where(solid.any(axis=1), solid.shape[1] - solid[:, ::-1].argmax(axis=1), 0).sum())
        return voxels * float(self.sides.prod())

    def densities(self, places: tuple[np.ndarray, np.ndarray, np.ndarray], voxel: float) -> np.ndarray:
        """How far values exceed the threshold, as about the distance to the surface: (X, Y, Z) float32, trilinear between voxels.

        places: coordinates along each axis, in any order. voxel: the distance of those that are asked for: fine voxels are averaged to it.
        """
        number = level_for(voxel, math.prod(self.sides.tolist()) ** (1.0 / 3.0), len(self.levels))
        level = self.levels[number]
        starts = (self.levels[0].shape[0] / 2.0, self.levels[0].shape[1] / 2.0, 0.0)
        lines = tuple(
            line_among((along / side + start) / 2.0**number, -1, count)
            for along, side, start, count in zip(places, self.sides, starts, level.shape, strict=True)
        )
        made = _with_outside(level, lines, self.outside)
        made -= np.float32(self.thresholds[number])
        made *= np.float32(self.factor)
        for axis in (2, 1, 0):
            made = swept(made, lines[axis], axis)
        return made


def volume(settings: "ClipboxSettings") -> terrains.Densities:
    """The block of a file, once.

    Raises:
        SettingsError, FileError: when there is no file, or none that gives voxels.
    """
    block = block_of(settings)
    return lambda grid: block.densities(tuple(grid.axis(axis) for axis in range(3)), grid.voxel)


def block_of(settings: "ClipboxSettings") -> VoxelBlock:
    """The voxels of the file that `settings` name.

    Raises:
        SettingsError, FileError: when there is no file, or none that gives voxels.
    """
    source = source_of(settings)
    if not isinstance(source, Voxels):
        raise FileError(f'"{settings.source}" holds heights, not voxels; choose the terrain "heights" for it.')
    values = np.ascontiguousarray(source.values)
    if values.dtype.kind == "f" and not (known := is_number(values)).all():
        if not known.any():
            raise FileError(f'"{settings.source}" holds no number anywhere.')
        values = np.where(known, values, values[known].min())
    smallest, largest = float(values.min()), float(values.max())
    outside = source.outside if source.outside is not None else 0.0 if values.dtype == bool else smallest
    low, high = (0.0, 1.0) if values.dtype == bool else (min(smallest, outside), max(largest, outside))
    threshold = low + (high - low) / 2.0
    if largest - threshold < LEAST_STEP:
        raise FileError(f'"{settings.source}" holds the same value everywhere, {smallest:g}; there is no surface in it.')
    if values.dtype.itemsize > 2:  # what single precision does not hold is taken from the threshold on
        beyond = np.empty(values.shape, np.float32)
        np.subtract(values, threshold, out=beyond, dtype=np.float64, casting="same_kind")
        values, outside, threshold = beyond, outside - threshold, 0.0
    spacing = np.array(source.spacing)
    sides = spacing * (settings.source_size * settings.scale / (spacing * values.shape).max())
    factor = SEEN_ALONG_AXES / _slope_along_axes(values, sides, threshold, high - low)
    return VoxelBlock(pyramid(values, outside), sides, threshold, outside, factor)


def _largest_along_axes(values: np.ndarray) -> np.ndarray:
    """The largest values along each line of voxels, lines along all three axes after each other."""
    return np.concatenate([values.max(axis=axis).ravel() for axis in range(3)])


def _slope_along_axes(values: np.ndarray, sides: np.ndarray, threshold: float, span: float) -> float:
    """The mean change in value a scene unit between neighbours on two sides of the surface; `span` a voxel if it lies around the block."""
    total, count = 0.0, 0
    for axis, side in enumerate(sides.tolist()):
        along, layers = np.moveaxis(values, axis, 0), values.shape[axis]
        first = np.unique(np.linspace(0, layers - 2, min(layers - 1, LAYERS_LOOKED_AT)).astype(np.int64)) if layers > 1 else []
        for layer in first:
            below, above = along[layer], along[layer + 1]
            crossed = (below > threshold) != (above > threshold)
            total += float(np.abs(above[crossed].astype(np.float64) - below[crossed].astype(np.float64)).sum()) / side
            count += int(crossed.sum())
    return total / count if count else span / float(sides.max())


def _with_outside(level: np.ndarray, lines: tuple[Line, Line, Line], outside: float) -> np.ndarray:
    """The samples (X, Y, Z) float32 that lines lie among; those that `level` does not hold are `outside`."""
    made = np.full([line.stop - line.start for line in lines], outside, np.float32)
    spans = [(max(line.start, 0), min(line.stop, count)) for line, count in zip(lines, level.shape, strict=True)]
    if all(low < high for low, high in spans):
        held = tuple(slice(low, high) for low, high in spans)
        made[tuple(slice(low - line.start, high - line.start) for (low, high), line in zip(spans, lines, strict=True))] = level[held]
    return made


terrains.register("volume", "A block of voxels from a file", volume)
