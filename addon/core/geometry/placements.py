"""Where the samples of a file lie, and local frames around them."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import FileError
from ..files.geotiff import GEOCENTRIC, GEOGRAPHIC, GeoReference
from .map_projections import ECCENTRICITY, SEMI_MAJOR_AXIS, TransverseMercator

MAX_LONGITUDES = 60.0  # degrees from west to east; the projection stretches what is farther from its central meridian too much
POLE = 90.0 + 1e-6  # degrees of latitude, and what rounding adds
ORIGIN_DECIMALS = 6  # An origin in degrees is rounded to about 0.1 m, so that reports show it completely.
MIN_COSINE = 1e-6  # replaces the cosine of latitudes at the poles, where meridians meet
METERS_PER_DEGREE = 111_320.0  # along the equator, and about that along a meridian; only for the size of cells


@dataclass(frozen=True)
class CurvatureSampling:
    """How the curvature of a grid in a local frame is measured.

    points: places along each side of the grid. step: distance of differences, as a fraction of the longer side. slack: factor for places
    between the points. min_derivative: replaces smaller first derivatives close to a pole, as a fraction of the largest one.
    """

    points: int = 9
    step: float = 0.01
    slack: float = 1.1
    min_derivative: float = 1e-3


CURVATURE = CurvatureSampling()


@dataclass(frozen=True)
class Placement:
    """The position of a grid: world = first + step * (column, row), row 0 in the south.

    Attributes:
        first: position of the sample in column 0 and row 0, meters, or degrees if `is_geographic`.
        step: distance between two samples along x and y, in the same unit.
        is_geographic: whether positions are longitudes and latitudes.
        code: code of the coordinate reference system, such as "EPSG:32632", None if it is unknown.
        is_placed: whether the file has a position.
    """

    first: tuple[float, float]
    step: tuple[float, float]
    is_geographic: bool = False
    code: str | None = None
    is_placed: bool = True

    @property
    def crs(self) -> str:
        """The coordinate reference system in words."""
        unit = "degrees" if self.is_geographic else "meters"
        return f"{self.code}, {unit}" if self.code else unit

    def has_other_crs(self, other: "Placement") -> bool:
        """Return whether two placements are known to be in different coordinate reference systems."""
        return self.is_geographic != other.is_geographic or (None not in (self.code, other.code) and self.code != other.code)

    def position(self, column: float, row: float) -> tuple[float, float]:
        """Return the world position of grid coordinates."""
        return self.first[0] + self.step[0] * column, self.first[1] + self.step[1] * row


def unplaced(cell_size: float) -> Placement:
    """Return the placement of a file without a position, whose cells are `cell_size` meters wide."""
    return Placement((0.0, 0.0), (cell_size, cell_size), is_placed=False)


def place_map(path: Path, reference: GeoReference, shape: tuple[int, int], cell_size: float) -> tuple[Placement, bool]:
    """Return the placement of a map with rows from north to south, and whether its rows run from south to north instead.

    cell_size: meters, for a file without a position.

    Raises:
        FileError: it is rotated, mirrored, or in units or a coordinate system that are not supported.
    """
    if reference.affine is None:
        return unplaced(cell_size), False
    if reference.is_rotated:
        raise FileError(f'"{path}" is rotated on the map; warp it to a grid along the axes of its projection.')
    if reference.model_type == GEOCENTRIC or reference.horizontal_unit is None:
        raise FileError(f'"{path}" has coordinates in a system or unit that is not supported; project it to meters or degrees.')
    width, _, x, _, depth, y = (number * reference.horizontal_unit for number in reference.affine)
    if width <= 0.0 or depth == 0.0:
        raise FileError(f'"{path}" is mirrored on the map; warp it to a grid whose columns run from west to east.')
    first = (x, y if depth > 0.0 else y + (shape[0] - 1) * depth)
    code = None if reference.epsg is None else f"EPSG:{reference.epsg}"
    return Placement(first, (width, abs(depth)), reference.model_type == GEOGRAPHIC, code), depth > 0.0


@dataclass(frozen=True)
class ProjectedFrame:
    """The local frame of a grid in meters: world positions minus an origin in whole meters near the center of the grid."""

    first: tuple[float, float]
    step: tuple[float, float]
    origin: tuple[float, float]

    def to_local(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return local meters, float64, of grid coordinates of any shape."""
        positions = (np.asarray(x, np.float64), np.asarray(y, np.float64))
        east, north = (self.first[axis] - self.origin[axis] + positions[axis] * self.step[axis] for axis in range(2))
        return east, north

    def to_grid(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return grid coordinates, float64, of local meters."""
        positions = (np.asarray(x, np.float64), np.asarray(y, np.float64))
        columns, rows = ((positions[axis] - (self.first[axis] - self.origin[axis])) / self.step[axis] for axis in range(2))
        return columns, rows

    def to_local_gradients(self, _x: np.ndarray, _y: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Return the derivatives (N, 2) float64 along local x and y of a function with `gradients` (N, 2) per cell at samples (N,)."""
        return gradients / np.array(self.step)

    def measure_curvature(self, _shape: tuple[int, int]) -> float:
        """Return 0: straight lines of the grid are straight in the local frame, too."""
        return 0.0


@dataclass(frozen=True)
class GeographicFrame:
    """The local frame of a grid in degrees: the transverse Mercator projection with its central meridian through the origin, and scale 1.

    Vertices are projected one by one, so that no height is resampled.
    """

    first: tuple[float, float]
    step: tuple[float, float]
    origin: tuple[float, float]

    def to_local(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return local meters, float64, of grid coordinates of any shape. Those far outside are clamped (`TransverseMercator.project`)."""
        longitudes = self.first[0] + np.asarray(x, np.float64) * self.step[0]
        latitudes = self.first[1] + np.asarray(y, np.float64) * self.step[1]
        east, north = self._projection.project(longitudes, latitudes)
        return east, north - self._north_of_origin

    def to_grid(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return grid coordinates, float64, of local meters."""
        longitudes, latitudes = self._projection.unproject(x, np.asarray(y, np.float64) + self._north_of_origin)
        return (longitudes - self.first[0]) / self.step[0], (latitudes - self.first[1]) / self.step[1]

    def to_local_gradients(self, x: np.ndarray, y: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Return the derivatives (N, 2) float64 along local x and y of a function with `gradients` (N, 2) per cell at samples (N,).

        The radii of the meridian and of the parallel are those of the ellipsoid, and the scale and the convergence of the projection those
        of the sphere, which differ by less than 1 %. The result for a sample is the same in every call.
        """
        offsets = np.radians(self.first[0] + x * self.step[0] - self.origin[0])
        latitudes = np.radians(self.first[1] + y * self.step[1])
        sines, cosines = np.sin(latitudes), np.maximum(np.cos(latitudes), MIN_COSINE)
        scale = 1.0 / np.sqrt(np.maximum(1.0 - (np.sin(offsets) * cosines) ** 2, MIN_COSINE))
        narrowing = 1.0 - (ECCENTRICITY * sines) ** 2
        prime_vertical = SEMI_MAJOR_AXIS / np.sqrt(narrowing)
        meridian = prime_vertical * (1.0 - ECCENTRICITY**2) / narrowing
        east = gradients[:, 0] / (scale * prime_vertical * cosines * math.radians(self.step[0]))
        north = gradients[:, 1] / (scale * meridian * math.radians(self.step[1]))
        convergence = np.arctan(np.tan(offsets) * sines)
        return np.stack(
            [
                east * np.cos(convergence) - north * np.sin(convergence),
                east * np.sin(convergence) + north * np.cos(convergence),
            ],
            axis=1,
        )

    def measure_curvature(self, shape: tuple[int, int]) -> float:
        """Return the curvature of straight lines of the grid in the local frame, in cells per square cell, for a grid of `shape` (rows,
        columns): the largest second derivative of `to_local` along any direction, relative to the smaller first derivative."""
        rows, columns = shape
        x, y = np.meshgrid(np.linspace(0.0, columns - 1.0, CURVATURE.points), np.linspace(0.0, rows - 1.0, CURVATURE.points))
        step = max(1.0, CURVATURE.step * max(shape))

        offsets = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        at = {(i, j): np.stack(self.to_local(x + i * step, y + j * step)) for i, j in offsets}
        along_x, along_y = at[1, 0] - at[-1, 0], at[0, 1] - at[0, -1]
        second_x, second_y = at[1, 0] + at[-1, 0] - 2.0 * at[0, 0], at[0, 1] + at[0, -1] - 2.0 * at[0, 0]
        mixed = (at[1, 1] + at[-1, -1] - at[1, -1] - at[-1, 1]) / 4.0
        second = np.sqrt((second_x**2 + second_y**2 + 2.0 * mixed**2).sum(axis=0)) / step**2
        first = np.minimum(np.linalg.norm(along_x, axis=0), np.linalg.norm(along_y, axis=0)) / (2.0 * step)
        return float(CURVATURE.slack * (second / np.maximum(first, CURVATURE.min_derivative * first.max())).max())

    @cached_property
    def _projection(self) -> TransverseMercator:
        return TransverseMercator(self.origin[0])

    @cached_property
    def _north_of_origin(self) -> float:
        return float(self._projection.project(self.origin[0], self.origin[1])[1])


Frame = ProjectedFrame | GeographicFrame


def create_frame(path: Path, placement: Placement, shape: tuple[int, int], scale: float = 1.0) -> tuple[Frame, float]:
    """Return the local frame of a grid with its origin near the center, and the nominal size of a cell in meters.

    path: named in errors. scale: true meters per meter of a projection, around the origin.

    Raises:
        FileError: the grid extends beyond a pole, or over too many degrees of longitude.
    """
    center = placement.position((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    width, depth = placement.step
    if not placement.is_geographic:
        origin = (float(round(center[0])), float(round(center[1])))
        first, step = placement.first, placement.step
        if scale != 1.0:
            first = tuple(start + scale * (position - start) for position, start in zip(first, origin, strict=True))
            step = (width * scale, depth * scale)
        return ProjectedFrame(first, step, origin), math.sqrt(step[0] * step[1])
    north = placement.position(0.0, shape[0] - 1)[1]
    if max(-placement.first[1], north) > POLE:
        raise FileError(
            f'"{path}" has latitudes from {placement.first[1]:g} to {north:g} degrees; its coordinates are no degrees, or wrong.'
        )
    longitudes = width * (shape[1] - 1)
    if longitudes > MAX_LONGITUDES:
        raise FileError(f'"{path}" covers {longitudes:g} degrees of longitude; the maximum is {MAX_LONGITUDES:g}, so use a part of it.')
    origin = (round(center[0], ORIGIN_DECIMALS), round(center[1], ORIGIN_DECIMALS))
    cell_size = METERS_PER_DEGREE * math.sqrt(width * depth * max(math.cos(math.radians(center[1])), 1e-6))
    return GeographicFrame(placement.first, placement.step, origin), cell_size
