"""Readers of terrain files, selected by file name extension. TIFF files may have GeoTIFF tags (OGC 19-008r4)."""

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from ...errors import FileError, SettingsError
from ...files.array_files import map_array
from ...files.file_access import check_readable, check_unicode
from ...files.geotiff import GEOGRAPHIC, GeoReference
from ...files.height_maps import HEIGHT_BYTES, are_valid_sizes, check_size, to_native_byte_order
from ...files.tiffs import TiffImage, open_tiff
from .file_data import FileData, HeightMap, Voxels
from .nifti import read_nifti

Readers = Mapping[str, Callable[[Path], FileData]]  # by lower-case extension
BLEND_PREFIX = "//"  # start of paths relative to the folder of the .blend file
RAW_NAME = re.compile(r"(?:^|_)(\d+)x(\d+)x(\d+)_(u?int(?:8|16|32)|float(?:32|64))$")
METERS_PER_DEGREE = 111_320.0  # along the equator, and about that along a meridian
MAX_LATITUDE = math.radians(89.9)  # closer to a pole, a degree of longitude has almost no length


def read_array(path: Path) -> FileData:
    """Read a NumPy array: heights (H, W) or voxels (X, Y, Z).

    Row 0 of heights is in the north, as in images and maps. Heights and the pixel size are in meters.

    Raises:
        FileError: it is neither.
    """
    mapped = map_array(path)
    if mapped.ndim not in (2, 3):
        raise FileError(f'"{path}" contains an array with {mapped.ndim} axes; heights have 2, voxels 3.')
    check_size(path, mapped.size, max(mapped.dtype.itemsize, HEIGHT_BYTES if mapped.dtype.kind == "f" else 1))
    values = to_native_byte_order(path, np.array(mapped))
    return Voxels(values) if values.ndim == 3 else HeightMap(values[::-1], (1.0, 1.0))


def read_raw(path: Path) -> Voxels:
    """Read a file of voxels without a header, whose shape and type are in its name, as in `skull_256x256x178_uint8.raw`.

    x varies fastest; the byte order is little-endian.

    Raises:
        FileError: the name does not contain them, or the file has another size.
    """
    match = RAW_NAME.search(path.stem)
    if match is None:
        raise FileError(f'The name of "{path}" must contain its shape and type, as in "skull_256x256x178_uint8.raw".')
    shape, dtype = tuple(int(count) for count in match.groups()[:3]), np.dtype(match[4]).newbyteorder("<")
    check_size(path, math.prod(shape), dtype.itemsize)
    expected_size, size = math.prod(shape) * dtype.itemsize, path.stat().st_size
    if size != expected_size:
        raise FileError(f'"{path}" has {size:,} bytes; according to its name it must have {expected_size:,}.')
    return Voxels(to_native_byte_order(path, np.fromfile(path, dtype)).reshape(shape, order="F"))


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
    with np.errstate(all="ignore"):  # Damaged floats become missing heights.
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


READERS: Readers = {
    ".npy": read_array,
    ".raw": read_raw,
    ".tif": read_tiff,
    ".tiff": read_tiff,
    ".nii": read_nifti,
    ".nii.gz": read_nifti,
}  # without Blender; `bridge.clipbox.sources` has those that need it


def read_source(terrain: str, source: str, readers: Readers) -> FileData:
    """Read the source file of a terrain.

    Raises:
        SettingsError: `source` is empty.
        FileError: the file cannot be read, or its path is relative to a .blend file that was never saved.
    """
    if not source:
        raise SettingsError(f'The terrain "{terrain}" needs a file; set Source.', ("source",))
    check_path(source)
    return read_file(Path(source), readers)


def check_path(path: str) -> None:
    """Raise FileError when a path is no text, or is still relative to the .blend file, because that was never saved."""
    check_unicode(Path(path))
    if path.startswith(BLEND_PREFIX):
        raise FileError(f'"{path}" is relative to the .blend file, which was never saved; save it, or use an absolute path.')


def read_file(path: Path, readers: Readers = READERS) -> FileData:
    """Read a file with the reader for its extension.

    Raises:
        FileError: the file is missing, empty, damaged, too large, or has an unknown extension.
    """
    name = path.name.lower()
    extension = max((known for known in readers if name.endswith(known)), key=len, default=None)
    check_readable(path)
    try:
        if extension is None:
            raise FileError(f'"{path}" cannot be read as terrain; its name must end in one of {", ".join(sorted(readers))}.')
        if path.stat().st_size == 0:
            raise FileError(f'The file "{path}" is empty.')
        return readers[extension](path)
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error.strerror or error}.') from error
    except MemoryError as error:
        raise FileError(f'"{path}" needs more memory than is available; reduce its size.') from error
