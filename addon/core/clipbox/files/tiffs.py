"""Heights from TIFF files with or without GeoTIFF tags (OGC 19-008r4; tag 42113 is GDAL's own)."""

import logging
import math
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import FileError
from .file_data import HEIGHT_BYTES, HeightMap, are_valid_sizes, check_size, to_native_byte_order

if TYPE_CHECKING:
    from tifffile import TiffPage

try:
    from lzma import LZMAError
except ImportError:  # Python can be built without it
    LZMAError = EOFError

PIXEL_SCALE, TIEPOINT, TRANSFORMATION, GEO_KEYS, NO_DATA = 33550, 33922, 34264, 34735, 42113  # tags
MODEL_TYPE, LINEAR_UNIT, VERTICAL_UNIT = 1024, 3076, 4099  # geo keys
GEOGRAPHIC = 2  # model type: x and y are degrees
METERS = {9001: 1.0, 9002: 0.3048, 9003: 1200.0 / 3937.0}  # by unit code: meter, foot, US survey foot
METERS_PER_DEGREE = 111_320.0  # along the equator, and about that along a meridian
MAX_LATITUDE = math.radians(89.9)  # closer to a pole, a degree of longitude has almost no length
TIFFFILE_ERRORS = (  # raised by tifffile and by decompression for damaged files
    *(ArithmeticError, AttributeError, EOFError, LookupError, RuntimeError, TypeError, ValueError),
    *(LZMAError, struct.error, zlib.error),
)

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # its remarks on damaged files do not go to stderr: an error names the file


def read_tiff(path: Path) -> HeightMap:
    """Read the first image of a TIFF file.

    Unsigned integers without any GeoTIFF tag are gray values, 0 to 1; of color images the mean of the first three channels is used. All
    other samples are elevations, in meters unless a tag gives a unit. A pixel without a scale is as wide as one unit of height.

    Raises:
        FileError: it is not a TIFF file, is truncated, or has an unsupported compression.
    """
    try:
        import tifffile  # imported here so that the core needs only NumPy and SciPy
    except ImportError:
        raise FileError(
            f'"{path}" needs the Python package tifffile, which is missing; install the Farfield extension, which includes it.'
        ) from None
    try:
        with np.errstate(all="ignore"), tifffile.TiffFile(path) as file:  # of damaged floats, which become missing heights
            page = file.pages.first
            _check_page(path, page, path.stat().st_size)
            samples = to_native_byte_order(path, page.asarray(maxworkers=1))
            return _to_height_map(path, page, samples)
    except TIFFFILE_ERRORS as error:
        if any(word in str(error) for word in ("imagecodecs", "COMPRESSION", "PREDICTOR")):
            raise FileError(f'"{path}" has an unsupported compression; save it without compression.') from error
        raise FileError(f'"{path}" cannot be read as a TIFF file: it is damaged or has another format; save it again.') from error


def _check_page(path: Path, page: "TiffPage", file_size: int) -> None:
    check_size(path, page.size, page.dtype.itemsize if page.dtype is not None else 1)
    check_size(path, page.imagelength * page.imagewidth, HEIGHT_BYTES)
    ends = [offset + count for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False)]
    if not ends or max(ends) > file_size or len(ends) < math.prod(page.chunked):
        raise FileError(f'"{path}" is truncated; copy the file again.')


def _to_height_map(path: Path, page: "TiffPage", samples: np.ndarray) -> HeightMap:
    image = _to_one_channel(path, page.axes, samples)
    is_map = any(page.tags.get(tag) is not None for tag in (PIXEL_SCALE, TRANSFORMATION, GEO_KEYS, NO_DATA))
    if samples.dtype.kind in "bu" and not is_map:
        white = 1.0 if samples.dtype == bool else float(np.iinfo(samples.dtype).max)
        gray = np.empty(image.shape, np.float32)
        np.divide(image, np.float32(white), out=gray, casting="same_kind")
        return HeightMap(gray[::-1])
    no_data = page.tags.get(NO_DATA)
    return HeightMap(image[::-1], _pixel_size(page, image.shape), None if no_data is None else _parse_number(no_data.value))


def _to_one_channel(path: Path, axes: str, samples: np.ndarray) -> np.ndarray:
    """Return samples (H, W), row 0 in the north, of an image with or without channels."""
    if axes in {"YXS", "SYX"}:
        channels = np.moveaxis(samples, axes.index("S"), 0)
        return channels[0] if len(channels) < 3 else channels[:3].mean(axis=0, dtype=np.float32)
    if axes != "YX":
        raise FileError(f'"{path}" contains samples along the axes {axes}; a height map must be a single image.')
    return samples


def _parse_number(value: object) -> float | None:
    try:
        return float(value if isinstance(value, int | float) else str(value).strip("\0 "))
    except ValueError:
        return None


def _pixel_size(page: "TiffPage", shape: tuple[int, int]) -> tuple[float, float]:
    """Return the width and depth of a pixel of an image (H, W), in the unit of its heights."""
    scale = page.tags.get(PIXEL_SCALE)
    width, depth = (abs(float(size)) for size in scale.value[:2]) if scale is not None else (0.0, 0.0)
    if not are_valid_sizes((width, depth)):
        return 1.0, 1.0
    keys = _read_geo_keys(page)
    height_unit = METERS.get(keys.get(VERTICAL_UNIT), 1.0)
    if keys.get(MODEL_TYPE) == GEOGRAPHIC:
        degree = METERS_PER_DEGREE / height_unit
        return width * degree * math.cos(_center_latitude(page, shape[0], depth)), depth * degree
    unit = METERS.get(keys.get(LINEAR_UNIT), 1.0) / height_unit
    return width * unit, depth * unit


def _read_geo_keys(page: "TiffPage") -> dict[int, int]:
    """Return the GeoTIFF keys with short integer values: rows of key, location, count, value after a header row."""
    tag = page.tags.get(GEO_KEYS)
    values = tag.value if tag is not None else ()
    rows = (values[start : start + 4] for start in range(4, len(values) - 3, 4))
    return {key: value for key, location, _, value in rows if location == 0}


def _center_latitude(page: "TiffPage", rows: int, depth: float) -> float:
    """Return the latitude of the center of the image, radians."""
    tiepoint = page.tags.get(TIEPOINT)
    if tiepoint is None or len(tiepoint.value) < 6:
        return 0.0
    _, row, _, _, latitude, _ = tiepoint.value[:6]
    center = math.radians(latitude - (rows / 2.0 - row) * depth)
    return min(max(center, -MAX_LATITUDE), MAX_LATITUDE)
