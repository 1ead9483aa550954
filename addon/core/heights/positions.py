"""The position of a height map: from its own tags, or from further files of the same name."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from ..files.geotiff import GEOGRAPHIC, PROJECTED, GeoReference, add_metadata
from ..geometry.coordinate_systems import WEB_MERCATOR, mercator_scale, seem_degrees
from ..geometry.placements import METERS_PER_DEGREE, Placement, place_map
from .auxiliary_files import find_world_file, read_auxiliary, read_projection, read_world_file

MIN_STRETCH = 0.001  # Less stretch of a projection is not worth a warning.
MAX_LATITUDE = 89.9  # degrees; closer to a pole, a degree of longitude has almost no length


@dataclass(frozen=True)
class Position:
    """Where a map lies. is_south_up: whether its first row is the southern one. warnings: sentences for the user."""

    placement: Placement
    is_south_up: bool
    warnings: tuple[str, ...] = ()


def complete_georeference(path: Path, reference: GeoReference) -> GeoReference:
    """Return the georeference of a map, completed by further files of the same name: GDAL's, a world file and a .prj file.

    Raises:
        FileError: one of them cannot be read or is damaged.
    """
    reference = add_metadata(reference, read_auxiliary(path))
    if reference.affine is None and (world_file := find_world_file(path)) is not None:
        reference = replace(reference, affine=read_world_file(world_file))
    return reference if reference.affine is None or reference.has_unit else _complete_unit(path, reference)


def find_position(path: Path, reference: GeoReference, shape: tuple[int, int], cell_size: float) -> Position:
    """Return the position of a map from its completed georeference.

    shape: rows and columns. cell_size: meters, for a file without a position.

    Raises:
        FileError: it is rotated, mirrored, or in units or a coordinate system that are not supported.
    """
    placement, is_south_up = place_map(path, reference, shape, cell_size)
    return Position(placement, is_south_up, tuple(f'"{path}" {remark}' for remark in reference.remarks))


def _complete_unit(path: Path, reference: GeoReference) -> GeoReference:
    """Return a georeference without a unit with that of the .prj file, or with degrees if its numbers can be nothing else."""
    projection = read_projection(path)
    a, b, x, d, e, y = reference.affine
    if projection is None and seem_degrees((x, y), (math.hypot(a, d), math.hypot(b, e))):
        remark = "has no coordinate reference system; its cells are so small that its coordinates are taken as degrees."
        return replace(reference, model_type=GEOGRAPHIC, horizontal_unit=1.0, remarks=(*reference.remarks, remark))
    if projection is None:
        return reference
    epsg = int(WEB_MERCATOR.partition(":")[2]) if projection.code == WEB_MERCATOR else None
    model_type = GEOGRAPHIC if projection.is_geographic else PROJECTED
    return replace(reference, model_type=model_type, epsg=epsg, horizontal_unit=projection.unit, has_unit=True)


def warn_of_stretch(path: Path, placement: Placement, shape: tuple[int, int]) -> tuple[str, ...]:
    """Return a warning if the projection of a grid stretches it by so much that it is corrected."""
    scale = center_scale(placement, shape)
    if scale > 1.0 - MIN_STRETCH:
        return ()
    return (f'"{path}" has a Mercator projection, which stretches it {1.0 / scale:.4g} times; its true size is used.',)


def center_scale(placement: Placement, shape: tuple[int, int]) -> float:
    """Return true meters per meter of the map in the center of a grid, 1 unless the projection stretches it (`mercator_scale`)."""
    return mercator_scale(placement.code, placement.position(0.0, (shape[0] - 1) / 2.0)[1])


def ground_spacing(placement: Placement, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the width and depth of a cell in the center of a grid, in true meters."""
    width, depth = placement.step
    if placement.is_geographic:
        latitude = placement.position(0.0, (shape[0] - 1) / 2.0)[1]
        latitude = math.radians(min(max(latitude, -MAX_LATITUDE), MAX_LATITUDE))
        return width * METERS_PER_DEGREE * math.cos(latitude), depth * METERS_PER_DEGREE
    scale = center_scale(placement, shape)
    return width * scale, depth * scale
