"""The position of a map on the ground from the tags of its TIFF file (OGC 19-008r4, GeoTIFF 1.1; 42112 and 42113 are GDAL's own).

The package rasterio reads more, but would add 36 MB to the zip of every platform for these few tags.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..geometry.coordinate_systems import (
    DEGREES_PER_GRAD,
    FOOT,
    GEOGRAPHIC_CODES,
    GRAD_CODES,
    SURVEY_FOOT,
    VERTICAL_CODES,
    WEB_MERCATOR,
    WEB_MERCATOR_NAME,
    unit_of_code,
    unit_of_name,
)
from ..messages import single_line
from .height_maps import are_valid_sizes

PIXEL_SCALE, TIEPOINT, TRANSFORMATION = 33550, 33922, 34264  # tags
GEO_KEYS, GEO_DOUBLES, GEO_TEXTS, GDAL_METADATA, NO_DATA = 34735, 34736, 34737, 42112, 42113
GEO_TAGS = (PIXEL_SCALE, TIEPOINT, TRANSFORMATION, GEO_KEYS, GEO_DOUBLES, GEO_TEXTS, GDAL_METADATA, NO_DATA)
MAP_TAGS = (PIXEL_SCALE, TRANSFORMATION, GEO_KEYS, NO_DATA)  # an image with one of these holds elevations, not gray values

MODEL_TYPE, RASTER_TYPE = 1024, 1025  # geo keys
GEOGRAPHIC_CRS, ANGULAR_UNIT, PROJECTED_CRS = 2048, 2054, 3072
LINEAR_UNIT, LINEAR_UNIT_SIZE, VERTICAL_CRS, VERTICAL_UNIT = 3076, 3077, 4096, 4099
PROJECTED, GEOGRAPHIC, GEOCENTRIC = 1, 2, 3  # values of MODEL_TYPE
POINT = 2  # value of RASTER_TYPE
USER_DEFINED = 32767
MAX_ROTATION = 1e-9  # Radians; less is rounding, and moves no sample by a thousandth of a pixel.

METERS = {9001: 1.0, 9002: FOOT, 9003: SURVEY_FOOT, 9036: 1000.0}  # by unit code: meter, foot, US survey foot, kilometer
DEGREES = {9101: math.degrees(1.0), 9102: 1.0, 9103: 1.0 / 60.0, 9104: 1.0 / 3600.0, 9105: DEGREES_PER_GRAD, 9106: DEGREES_PER_GRAD}
NO_VERTICAL_UNIT = "has positions in feet and heights without a unit; they are taken as meters."
MAX_METADATA = 1 << 20  # characters of GDAL's metadata that are searched
METADATA_ITEM = re.compile(r"<Item\b([^<>]*)>([^<>]*)</Item>")  # elements with text only
METADATA_ATTRIBUTE = re.compile(r"\b(\w+)\s*=\s*[\"']([^\"']*)[\"']")


@dataclass(frozen=True)
class GeoReference:
    """Where a map lies.

    Attributes:
        affine: (a, b, c, d, e, f) of x = a * column + b * row + c and y = d * column + e * row + f, in units of the model, at the centers
            of pixels counted from (0, 0) in the north-west; None where the file gives no pixel size.
        model_type: PROJECTED, GEOGRAPHIC, GEOCENTRIC, or None.
        epsg: code of the coordinate reference system, None if it is not declared or user-defined.
        has_unit: whether the file declares the unit of its positions, or a system that tells it.
        horizontal_unit: degrees of a geographic model, meters of all others; None if its code is unknown.
        vertical_unit: meters.
        no_data: the sample that means unknown.
        scale, offset: a height in the vertical unit is a sample times the scale, plus the offset.
        remarks: ends of sentences for the user that begin with the file, about what is not as the file may mean it.
    """

    affine: tuple[float, float, float, float, float, float] | None = None
    model_type: int | None = None
    epsg: int | None = None
    has_unit: bool = False
    horizontal_unit: float | None = 1.0
    vertical_unit: float = 1.0
    no_data: float | None = None
    scale: float = 1.0
    offset: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def is_rotated(self) -> bool:
        """Whether rows do not run along x or columns not along y."""
        if self.affine is None:
            return False
        a, b, _, d, e, _ = self.affine
        return max(abs(b), abs(d)) > MAX_ROTATION * max(abs(a), abs(e))


def read_georeference(tags: Mapping[int, object]) -> GeoReference:
    """Return the georeference from the values of the tags GEO_TAGS, by number. Damaged tags count as missing."""
    keys, metadata = _read_geo_keys(tags), _read_metadata(tags)
    model_type, epsg = _read_system(keys, str(tags.get(GEO_TEXTS, "")))
    if model_type == GEOGRAPHIC:
        horizontal_unit = DEGREES.get(int(keys.get(ANGULAR_UNIT, 9105 if epsg in GRAD_CODES else 9102)))
    elif LINEAR_UNIT in keys:
        horizontal_unit = METERS.get(int(keys[LINEAR_UNIT]), keys.get(LINEAR_UNIT_SIZE))
    else:
        horizontal_unit = 1.0 if epsg is None else unit_of_code(epsg)
    vertical_unit, remarks = _read_vertical_unit(keys, horizontal_unit if model_type == PROJECTED else 1.0)
    reference = GeoReference(
        affine=_read_affine(tags, is_point=keys.get(RASTER_TYPE) == POINT),
        model_type=model_type,
        epsg=epsg,
        has_unit=model_type in (GEOGRAPHIC, GEOCENTRIC) or epsg is not None or LINEAR_UNIT in keys,
        horizontal_unit=horizontal_unit,
        vertical_unit=vertical_unit,
        no_data=_parse_number(tags[NO_DATA]) if NO_DATA in tags else None,
        remarks=remarks,
    )
    return add_metadata(reference, metadata)


def add_metadata(reference: GeoReference, metadata: Mapping[str, str]) -> GeoReference:
    """Return a georeference with texts of GDAL: scale, offset, unittype and nodatavalue, and geotransform if it has no position."""
    scale, offset, no_data = (_parse_number(metadata.get(role, "")) for role in ("scale", "offset", "nodatavalue"))
    if scale is not None and are_valid_sizes((abs(scale),)):
        reference = replace(reference, scale=scale)
    if offset is not None and math.isfinite(offset):
        reference = replace(reference, offset=offset)
    if no_data is not None:
        reference = replace(reference, no_data=no_data)
    if reference.affine is None and (affine := _parse_transform(metadata.get("geotransform", ""))) is not None:
        reference = replace(reference, affine=affine)
    name = single_line(metadata.get("unittype", "")).strip()
    if name and (unit := unit_of_name(name)) is not None:
        return replace(reference, vertical_unit=unit, remarks=tuple(text for text in reference.remarks if text != NO_VERTICAL_UNIT))
    unknown = (f'has heights in the unknown unit "{name[:40]}"; they are taken as meters.',) if name else ()
    return replace(reference, remarks=(*reference.remarks, *unknown))


def _parse_transform(text: str) -> tuple[float, float, float, float, float, float] | None:
    """Return the affine map from the six numbers of GDAL, which count from the corner of the first pixel."""
    numbers = [_parse_number(word) for word in text.split(",")]
    if len(numbers) != 6 or not all(number is not None and math.isfinite(number) for number in numbers):
        return None
    x, a, b, y, d, e = numbers
    is_valid = are_valid_sizes((math.hypot(a, d), math.hypot(b, e)))
    return (a, b, x + 0.5 * (a + b), d, e, y + 0.5 * (d + e)) if is_valid else None


def has_elevations(tags: Mapping[int, object]) -> bool:
    """Return whether tags say that an image holds elevations, not gray values."""
    return any(code in tags for code in MAP_TAGS) or not {"scale", "offset", "unittype"}.isdisjoint(_read_metadata(tags))


def _read_system(keys: Mapping[int, float], texts: str) -> tuple[int | None, int | None]:
    """Return the model type and the EPSG code. Files without a model type have the one of the system that they name."""
    codes = {key: int(keys[key]) for key in (GEOGRAPHIC_CRS, PROJECTED_CRS) if 0 < keys.get(key, 0) < 2**31}
    model_type = int(keys[MODEL_TYPE]) if keys.get(MODEL_TYPE) in (PROJECTED, GEOGRAPHIC, GEOCENTRIC) else None
    if model_type is None and codes:
        model_type = PROJECTED if PROJECTED_CRS in codes else GEOGRAPHIC
    if model_type != GEOGRAPHIC and codes.get(PROJECTED_CRS) in GEOGRAPHIC_CODES:
        model_type, codes = GEOGRAPHIC, {GEOGRAPHIC_CRS: codes[PROJECTED_CRS]}
    epsg = codes.get(GEOGRAPHIC_CRS if model_type == GEOGRAPHIC else PROJECTED_CRS, USER_DEFINED)
    if epsg == USER_DEFINED:
        epsg = int(WEB_MERCATOR.partition(":")[2]) if model_type == PROJECTED and WEB_MERCATOR_NAME.search(texts) else None
    return model_type, epsg


def _read_vertical_unit(keys: Mapping[int, float], horizontal_unit: float | None) -> tuple[float, tuple[str, ...]]:
    """Return the meters per unit of the heights, and remarks."""
    if VERTICAL_UNIT in keys or VERTICAL_CRS in keys:
        return METERS.get(keys.get(VERTICAL_UNIT), VERTICAL_CODES.get(keys.get(VERTICAL_CRS), 1.0)), ()
    return 1.0, (NO_VERTICAL_UNIT,) if horizontal_unit in (FOOT, SURVEY_FOOT) else ()


def _read_metadata(tags: Mapping[int, object]) -> dict[str, str]:
    """Return the values of GDAL's metadata that describe the first band, by role: offset, scale, unittype."""
    values = {}
    for attributes, text in METADATA_ITEM.findall(str(tags.get(GDAL_METADATA, ""))[:MAX_METADATA]):
        item = dict(METADATA_ATTRIBUTE.findall(attributes))
        if item.get("sample", "0") == "0" and "role" in item:
            values.setdefault(item["role"].lower(), text)
    return values


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
        return float(value if isinstance(value, int | float) else str(value).strip("\0 ").replace(",", "."))
    except ValueError:
        return None
