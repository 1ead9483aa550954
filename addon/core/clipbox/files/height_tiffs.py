"""Height maps from TIFF files with or without GeoTIFF tags (OGC 19-008r4)."""

import math
from pathlib import Path

import numpy as np

from ...files.geotiff import GEOGRAPHIC, GeoReference
from ...files.height_maps import HEIGHT_BYTES, are_valid_sizes, check_size
from ...files.tiffs import TiffImage, open_tiff
from .file_data import HeightMap

METERS_PER_DEGREE = 111_320.0  # along the equator, and about that along a meridian
MAX_LATITUDE = math.radians(89.9)  # closer to a pole, a degree of longitude has almost no length


def read_tiff(path: Path) -> HeightMap:
    """Read the first image of a TIFF file.

    Unsigned integers without any GeoTIFF tag are gray values, 0 to 1; of color images the mean of the first three channels is used. All
    other samples are elevations, in meters unless a tag gives a unit. A pixel without a scale is as wide as one unit of height.

    Raises:
        FileError: it is not a TIFF file, is truncated, or has an unsupported compression.
    """
    tiff = open_tiff(path)
    check_size(path, math.prod(tiff.shape) * tiff.channels, tiff.dtype.itemsize)
    check_size(path, math.prod(tiff.shape), HEIGHT_BYTES)
    tiff.check_complete()
    samples = tiff.read(slice(0, tiff.shape[0]), slice(0, tiff.shape[1]))
    with np.errstate(all="ignore"):  # of damaged floats, which become missing heights
        return _to_height_map(tiff, samples)


def _to_height_map(tiff: TiffImage, samples: np.ndarray) -> HeightMap:
    image = samples[:, :, 0] if tiff.channels < 3 else samples[:, :, :3].mean(axis=2, dtype=np.float32)
    if samples.dtype.kind in "bu" and not tiff.is_map:
        white = 1.0 if samples.dtype == bool else float(np.iinfo(samples.dtype).max)
        gray = np.empty(image.shape, np.float32)
        np.divide(image, np.float32(white), out=gray, casting="same_kind")
        return HeightMap(gray[::-1])
    return HeightMap(image[::-1], _pixel_size(tiff.georeference, tiff.shape[0]), tiff.georeference.no_data)


def _pixel_size(reference: GeoReference, rows: int) -> tuple[float, float]:
    """Return the width and depth of a pixel, in the unit of its heights."""
    if reference.affine is None:
        return 1.0, 1.0
    a, b, _, d, e, y = reference.affine
    unit = (reference.horizontal_unit or 1.0) / reference.vertical_unit
    width, depth = math.hypot(a, d) * unit, math.hypot(b, e) * unit
    if reference.model_type == GEOGRAPHIC:
        latitude = math.radians((y + (rows - 1) / 2.0 * e) * (reference.horizontal_unit or 1.0))
        latitude = min(max(latitude, -MAX_LATITUDE), MAX_LATITUDE)
        width, depth = width * METERS_PER_DEGREE * math.cos(latitude), depth * METERS_PER_DEGREE
    return (width, depth) if are_valid_sizes((width, depth)) else (1.0, 1.0)
