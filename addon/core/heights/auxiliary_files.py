"""Files that accompany a map: its position, its coordinate reference system, and what its numbers mean.

A world file has six lines of text (Esri, World files for raster datasets): A, D, B, E, C and F of x = A * column + B * row + C and
y = D * column + E * row + F, at the centers of pixels counted from (0, 0) in the upper left corner. A `.prj` file has the coordinate
reference system as WKT. A file `NAME.aux.xml` is GDAL's (Persistent Auxiliary Metadata), which ArcGIS and QGIS write too.
"""

import html
import math
import re
from pathlib import Path

from ..errors import FileError
from ..files.file_access import check_readable, convert_os_errors, has_companion
from ..files.height_maps import are_valid_sizes
from ..geometry.coordinate_systems import Projection, parse_projection

MAX_WORLD_FILE_BYTES = 1024
MAX_WKT_BYTES = 1 << 16
MAX_AUXILIARY_BYTES = 1 << 20
AUXILIARY_ITEM = re.compile(r"<(SRS|GeoTransform|NoDataValue|Scale|Offset|UnitType)\b[^<>]*>([^<>]*)</")
OTHER_BANDS = re.compile(r"<PAMRasterBand band=\"(?!1\")")


def find_world_file(image: Path) -> Path | None:
    """Return the world file of an image, None if there is none: the first and last letter of its file name extension with a w, the whole
    extension with a w, or .wld."""
    letters = image.suffix[1:]
    if not letters:
        return None
    names = (f"{letters[0]}{letters[-1]}w", f"{letters}w", "wld")
    candidates = (image.with_suffix(f".{name}") for ending in names for name in (ending, ending.lower(), ending.upper()))
    return next((path for path in candidates if has_companion(path)), None)


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
    """Return what the .prj file of a map tells, or else GDAL's file; None if they tell nothing. Raises FileError."""
    found = next((found for found in (path.with_suffix(".prj"), path.with_suffix(".PRJ")) if has_companion(found)), None)
    return parse_projection(read_auxiliary(path).get("srs", "") if found is None else _read_text(found, MAX_WKT_BYTES))


def read_auxiliary(path: Path) -> dict[str, str]:
    """Return the texts in the `.aux.xml` file of a map: srs and geotransform, nodatavalue, scale, offset and unittype of its first band,
    as far as they are there. Raises FileError if it cannot be read."""
    found = path.with_name(f"{path.name}.aux.xml")
    text = _read_text(found, MAX_AUXILIARY_BYTES) if has_companion(found) else ""
    values: dict[str, str] = {}
    for name, value in AUXILIARY_ITEM.findall(OTHER_BANDS.split(text)[0]):
        values.setdefault(name.lower(), html.unescape(value).strip())
    return values


def _read_text(path: Path, max_bytes: int) -> str:
    check_readable(path)
    with convert_os_errors(f'"{path}" cannot be read'), path.open("rb") as file:
        return file.read(max_bytes).decode("utf-8-sig", "replace")
