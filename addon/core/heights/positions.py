"""The position of a height map: from its own tags, or from further files of the same name.

The position of an image without tags may be in a world file with six lines of text (Esri, World files for raster datasets): A, D, B, E, C
and F of x = A * column + B * row + C and y = D * column + E * row + F, at the centers of pixels counted from (0, 0) in the upper left
corner. A .prj file has the coordinate reference system as WKT.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import FileError
from ..files.file_access import check_readable, convert_os_errors
from ..files.geotiff import GEOGRAPHIC, PROJECTED, GeoReference
from ..files.height_maps import are_valid_sizes
from ..geometry.coordinate_systems import WEB_MERCATOR, Projection, mercator_scale, parse_projection, seem_degrees
from ..geometry.placements import Placement, place_map

MAX_WORLD_FILE_BYTES = 1024
MAX_WKT_BYTES = 1 << 16
MIN_STRETCH = 0.001  # Less stretch of a projection is not worth a warning.
METERS_PER_DEGREE = 111_320.0  # along the equator, and about that along a meridian
MAX_LATITUDE = 89.9  # degrees; closer to a pole, a degree of longitude has almost no length


@dataclass(frozen=True)
class Position:
    """Where a map lies. is_south_up: whether its first row is the southern one. warnings: sentences for the user."""

    placement: Placement
    is_south_up: bool
    warnings: tuple[str, ...] = ()


def find_position(path: Path, reference: GeoReference, shape: tuple[int, int], cell_size: float) -> Position:
    """Return the position of a map from its georeference, completed by a world file and a .prj file of the same name.

    shape: rows and columns. cell_size: meters, for a file without a position.

    Raises:
        FileError: it is rotated, mirrored, or in units or a coordinate system that are not supported, or a further file is damaged.
    """
    if reference.affine is None and (world_file := find_world_file(path)) is not None:
        reference = replace(reference, affine=read_world_file(world_file))
    if reference.affine is not None and not reference.has_unit:
        reference = _complete_unit(path, reference)
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


def find_world_file(image: Path) -> Path | None:
    """Return the world file of an image, None if there is none: the first and last letter of its file name extension with a w, the whole
    extension with a w, or .wld."""
    letters = image.suffix[1:]
    if not letters:
        return None
    names = (f"{letters[0]}{letters[-1]}w", f"{letters}w", "wld")
    candidates = (image.with_suffix(f".{name}") for ending in names for name in (ending, ending.lower(), ending.upper()))
    return next((path for path in candidates if path.is_file()), None)


def read_world_file(path: Path) -> tuple[float, float, float, float, float, float]:
    """Return (a, b, c, d, e, f) of a world file in the order of `GeoReference.affine`: x = a * column + b * row + c, y = d * column +
    e * row + f.

    Raises:
        FileError: it cannot be read, or does not contain six numbers.
    """
    with convert_os_errors(f'"{path}" cannot be read'), path.open("rb") as file:
        words = file.read(MAX_WORLD_FILE_BYTES).replace(b",", b".").split()
    try:
        a, d, b, e, c, f = (float(word) for word in words[:6])
    except ValueError as error:
        raise FileError(f'"{path}" is no world file: it must contain six numbers, one per line.') from error
    is_valid = all(math.isfinite(number) for number in (a, b, c, d, e, f))
    if not is_valid or not are_valid_sizes((math.hypot(a, d), math.hypot(b, e))):
        raise FileError(f'"{path}" is no world file: its pixels have no size; export it again.')
    return a, b, c, d, e, f


def read_projection(path: Path) -> Projection | None:
    """Return what the .prj file of a map tells, None if there is none, or it is no WKT. Raises FileError if it cannot be read."""
    file_path = next((found for found in (path.with_suffix(".prj"), path.with_suffix(".PRJ")) if found.is_file()), None)
    if file_path is None:
        return None
    check_readable(file_path)
    with convert_os_errors(f'"{file_path}" cannot be read'), file_path.open("rb") as file:
        return parse_projection(file.read(MAX_WKT_BYTES).decode("utf-8-sig", "replace"))
