"""The position of a map on the ground from the tags of its TIFF file (OGC 19-008r4, GeoTIFF 1.1; tag 42113 is GDAL's own).

The package rasterio reads more, but would add 36 MB to the zip of every platform for these few tags.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .height_maps import are_valid_sizes

PIXEL_SCALE, TIEPOINT, TRANSFORMATION = 33550, 33922, 34264  # tags
GEO_KEYS, GEO_DOUBLES, NO_DATA = 34735, 34736, 42113
GEO_TAGS = (PIXEL_SCALE, TIEPOINT, TRANSFORMATION, GEO_KEYS, GEO_DOUBLES, NO_DATA)
MAP_TAGS = (PIXEL_SCALE, TRANSFORMATION, GEO_KEYS, NO_DATA)  # an image with one of these holds elevations, not gray values

MODEL_TYPE, RASTER_TYPE = 1024, 1025  # geo keys
GEOGRAPHIC_CRS, ANGULAR_UNIT, PROJECTED_CRS = 2048, 2054, 3072
LINEAR_UNIT, LINEAR_UNIT_SIZE, VERTICAL_CRS, VERTICAL_UNIT = 3076, 3077, 4096, 4099
PROJECTED, GEOGRAPHIC, GEOCENTRIC = 1, 2, 3  # values of MODEL_TYPE
POINT = 2  # value of RASTER_TYPE
USER_DEFINED = 32767
MAX_ROTATION = 1e-9  # Radians; less is rounding, and moves no sample by a thousandth of a pixel.

METERS = {9001: 1.0, 9002: 0.3048, 9003: 1200.0 / 3937.0}  # by unit code: meter, foot, US survey foot
VERTICAL_CRS_METERS = {5702: 1200.0 / 3937.0, 6360: 1200.0 / 3937.0, 8228: 0.3048}  # heights above NGVD29 and NAVD88 in feet
DEGREES = {9101: math.degrees(1.0), 9102: 1.0, 9103: 1.0 / 60.0, 9104: 1.0 / 3600.0, 9105: 0.9}  # radian to gon


@dataclass(frozen=True)
class GeoReference:
    """Where a map lies.

    Attributes:
        affine: (a, b, c, d, e, f) of x = a * column + b * row + c and y = d * column + e * row + f, in units of the model, at the centers
            of pixels counted from (0, 0) in the north-west; None where the file gives no pixel size.
        is_point: whether the file counts from the centers of pixels (pixel-is-point), not from their corners; `affine` allows for it.
        model_type: PROJECTED, GEOGRAPHIC, GEOCENTRIC, or None.
        epsg: code of the coordinate reference system, None if it is not declared or user-defined.
        horizontal_unit: degrees of a geographic model, meters of all others; None if its code is unknown.
        vertical_unit: meters.
        no_data: the number that means unknown.
    """

    affine: tuple[float, float, float, float, float, float] | None = None
    is_point: bool = False
    model_type: int | None = None
    epsg: int | None = None
    horizontal_unit: float | None = 1.0
    vertical_unit: float = 1.0
    no_data: float | None = None

    @property
    def is_rotated(self) -> bool:
        """Whether rows do not run along x or columns not along y."""
        if self.affine is None:
            return False
        a, b, _, d, e, _ = self.affine
        return max(abs(b), abs(d)) > MAX_ROTATION * max(abs(a), abs(e))


def read_georeference(tags: Mapping[int, object]) -> GeoReference:
    """Return the georeference from the values of the tags GEO_TAGS, by number. Damaged tags count as missing."""
    keys = _read_geo_keys(tags)
    model_type = keys.get(MODEL_TYPE)
    is_point = keys.get(RASTER_TYPE) == POINT
    epsg = keys.get(GEOGRAPHIC_CRS if model_type == GEOGRAPHIC else PROJECTED_CRS)
    if model_type == GEOGRAPHIC:
        horizontal_unit = DEGREES.get(int(keys.get(ANGULAR_UNIT, 9102)))
    else:
        horizontal_unit = METERS.get(int(keys.get(LINEAR_UNIT, 9001)), keys.get(LINEAR_UNIT_SIZE))
    vertical_unit = METERS.get(keys.get(VERTICAL_UNIT), VERTICAL_CRS_METERS.get(keys.get(VERTICAL_CRS), 1.0))
    return GeoReference(
        affine=_read_affine(tags, is_point),
        is_point=is_point,
        model_type=None if model_type is None else int(model_type),
        epsg=None if epsg in (None, 0, USER_DEFINED) else int(epsg),
        horizontal_unit=horizontal_unit,
        vertical_unit=vertical_unit,
        no_data=_parse_number(tags[NO_DATA]) if NO_DATA in tags else None,
    )


def _read_affine(tags: Mapping[int, object], is_point: bool) -> tuple[float, float, float, float, float, float] | None:
    scale, tiepoint = _numbers(tags.get(PIXEL_SCALE)), _numbers(tags.get(TIEPOINT))
    matrix = _numbers(tags.get(TRANSFORMATION))
    if len(scale) >= 2 and are_valid_sizes((abs(scale[0]), abs(scale[1]))):
        width, depth = abs(scale[0]), abs(scale[1])
        column, row, _, x, y, _ = tiepoint[:6] if len(tiepoint) >= 6 else (0.0,) * 6
        affine = (width, 0.0, x - column * width, 0.0, -depth, y + row * depth)
    elif len(matrix) == 16 and are_valid_sizes((math.hypot(matrix[0], matrix[4]), math.hypot(matrix[1], matrix[5]))):
        affine = (matrix[0], matrix[1], matrix[3], matrix[4], matrix[5], matrix[7])
    else:
        return None
    a, b, c, d, e, f = affine
    center = 0.0 if is_point else 0.5  # Where the first pixel lies.
    affine = (a, b, c + center * (a + b), d, e, f + center * (d + e))
    return affine if all(math.isfinite(number) for number in affine) else None


def _read_geo_keys(tags: Mapping[int, object]) -> dict[int, float]:
    """Return the GeoTIFF keys with numbers: rows of key, location, count, value after a header row."""
    values, doubles, keys = tags.get(GEO_KEYS), _numbers(tags.get(GEO_DOUBLES)), {}
    values = values if isinstance(values, Sequence) and not isinstance(values, str | bytes) else ()
    for start in range(4, len(values) - 3, 4):
        key, location, _, value = values[start : start + 4]
        if location == 0:
            keys[key] = value
        elif location == GEO_DOUBLES and value < len(doubles):
            keys[key] = doubles[value]
    return keys


def _numbers(value: object) -> tuple[float, ...]:
    """Return the numbers of a tag, none if it holds something else."""
    is_list = isinstance(value, Sequence) and all(isinstance(number, int | float) for number in value)
    return tuple(float(number) for number in value) if is_list else ()


def _parse_number(value: object) -> float | None:
    try:
        return float(value if isinstance(value, int | float) else str(value).strip("\0 "))
    except ValueError:
        return None
