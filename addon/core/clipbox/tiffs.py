"""Heights from TIFF files, and what GeoTIFF tags say of them (OGC 19-008r4; tag 42113 is GDAL's own)."""

import math
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileError
from .samples import HeightMap, are_sides, check_size, native

if TYPE_CHECKING:
    from tifffile import TiffPage

try:
    from lzma import LZMAError
except ImportError:  # Python can be built without it
    LZMAError = EOFError

PIXEL_SCALE, TIEPOINT, TRANSFORMATION, GEO_KEYS, NO_DATA = 33550, 33922, 34264, 34735, 42113  # tags
MODEL_TYPE, LINEAR_UNIT, VERTICAL_UNIT = 1024, 3076, 4099  # keys among the geo keys
GEOGRAPHIC = 2  # model type: x and y are degrees
METRES = {9001: 1.0, 9002: 0.3048, 9003: 1200.0 / 3937.0}  # codes of units: metre, foot, US survey foot
METRES_A_DEGREE = 111_320.0  # along the equator, and about that along a meridian
NEAREST_POLE = math.radians(89.9)  # nearer to it a degree of longitude is next to nothing
BROKEN = (  # what tifffile and decompression raise where a file is not as it should be
    *(ArithmeticError, AttributeError, EOFError, LookupError, RuntimeError, TypeError, ValueError),
    *(LZMAError, struct.error, zlib.error),
)


def read_tiff(path: Path) -> HeightMap:
    """The first picture of a TIFF.

    Unsigned whole numbers without any GeoTIFF tag are grey, 0 to 1, and of colours the mean of the first three channels counts. All other
    samples are elevations, in metres where no tag tells a unit; a pixel without a scale is as wide as one unit of height.

    Raises:
        FileError: when it is none, is cut short, or is compressed in a way that cannot be read.
    """
    try:
        import tifffile  # here, so that importing the core needs only NumPy and SciPy
    except ImportError:
        raise FileError(
            f'"{path}" needs the Python package tifffile, which is missing; install the Farfield extension, which brings it.'
        ) from None
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            _check_page(path, page, path.stat().st_size)
            samples = native(path, page.asarray(maxworkers=1))
            return _height_map(path, page, samples)
    except BROKEN as error:
        if any(word in str(error) for word in ("imagecodecs", "COMPRESSION", "PREDICTOR")):
            raise FileError(f'"{path}" is compressed in a way that is not known here; save it without compression.') from error
        raise FileError(f'"{path}" cannot be read as a TIFF: it is broken or something else; save it anew.') from error


def _check_page(path: Path, page: "TiffPage", file_size: int) -> None:
    check_size(path, page.size, page.dtype.itemsize if page.dtype is not None else 1)
    ends = [offset + count for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False)]
    if not ends or max(ends) > file_size or len(ends) < math.prod(page.chunked):
        raise FileError(f'"{path}" is cut short; copy it here again.')


def _height_map(path: Path, page: "TiffPage", samples: np.ndarray) -> HeightMap:
    image = _one_channel(path, page.axes, samples)
    is_map = any(page.tags.get(code) is not None for code in (PIXEL_SCALE, TRANSFORMATION, GEO_KEYS, NO_DATA))
    if samples.dtype.kind in "bu" and not is_map:
        white = 1.0 if samples.dtype == bool else float(np.iinfo(samples.dtype).max)
        return HeightMap((image / np.float32(white)).astype(np.float32)[::-1])
    no_data = page.tags.get(NO_DATA)
    return HeightMap(image[::-1], _pixel(page, image.shape), None if no_data is None else _number(no_data.value))


def _one_channel(path: Path, axes: str, samples: np.ndarray) -> np.ndarray:
    """Samples (H, W), row 0 in the north, out of a picture with or without channels."""
    if axes in {"YXS", "SYX"}:
        channels = np.moveaxis(samples, axes.index("S"), 0)
        return channels[0] if len(channels) < 3 else channels[:3].mean(axis=0, dtype=np.float32)
    if axes != "YX":
        raise FileError(f'"{path}" holds samples along the axes {axes}; heights need a single picture.')
    return samples


def _number(value: object) -> float | None:
    try:
        return float(value if isinstance(value, int | float) else str(value).strip("\0 "))
    except ValueError:
        return None


def _pixel(page: "TiffPage", shape: tuple[int, int]) -> tuple[float, float]:
    """Width and depth of a pixel of an image (H, W), in the unit of its heights."""
    scale = page.tags.get(PIXEL_SCALE)
    width, depth = (abs(float(side)) for side in scale.value[:2]) if scale is not None else (0.0, 0.0)
    if not are_sides((width, depth)):
        return 1.0, 1.0
    keys = _geo_keys(page)
    height_unit = METRES.get(keys.get(VERTICAL_UNIT), 1.0)
    if keys.get(MODEL_TYPE) == GEOGRAPHIC:
        degree = METRES_A_DEGREE / height_unit
        return width * degree * math.cos(_latitude(page, shape[0], depth)), depth * degree
    unit = METRES.get(keys.get(LINEAR_UNIT), 1.0) / height_unit
    return width * unit, depth * unit


def _geo_keys(page: "TiffPage") -> dict[int, int]:
    """The GeoTIFF keys whose values are short numbers: rows of key, place, count, value after a first row."""
    tag = page.tags.get(GEO_KEYS)
    words = tag.value if tag is not None else ()
    rows = (words[at : at + 4] for at in range(4, len(words) - 3, 4))
    return {key: value for key, place, _, value in rows if place == 0}


def _latitude(page: "TiffPage", rows: int, depth: float) -> float:
    """The latitude of the middle of the picture, radians."""
    tiepoint = page.tags.get(TIEPOINT)
    if tiepoint is None or len(tiepoint.value) < 6:
        return 0.0
    _, row, _, _, latitude, _ = tiepoint.value[:6]
    middle = math.radians(latitude - (rows / 2.0 - row) * depth)
    return min(max(middle, -NEAREST_POLE), NEAREST_POLE)
