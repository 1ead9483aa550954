"""Readers of terrain files, selected by file name extension."""

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from ...errors import FileError, SettingsError
from ...files.array_files import map_array
from ...files.file_access import check_readable, check_unicode
from ...files.height_maps import CHUNK_SAMPLES, HEIGHT_BYTES, MAX_BYTES, check_size, to_native_byte_order
from ...files.segment_cache import SegmentCache
from ...heights.positions import ground_spacing, warn_of_stretch
from ...heights.readers import open_source
from ...heights.sources import ReadImage, SourceContext
from ...heights.voids import find_voids, mask_voids, name_voids
from .file_data import FileData, HeightMap, Voxels
from .nifti import read_nifti

Readers = Mapping[str, Callable[[Path], FileData]]  # by lower-case extension
BLEND_PREFIX = "//"  # start of paths relative to the folder of the .blend file
RAW_NAME = re.compile(r"(?:^|_)(\d+)x(\d+)x(\d+)_(u?int(?:8|16|32)|float(?:32|64))$")


def read_array(path: Path) -> FileData:
    """Read a NumPy array: heights (H, W) or voxels (X, Y, Z).

    Row 0 of heights is in the north, as in images and maps. Heights and the pixel size are in meters.

    Raises:
        FileError: it is neither.
    """
    mapped = map_array(path)
    if mapped.ndim == 2:
        return read_heights(path)
    if mapped.ndim != 3:
        raise FileError(f'"{path}" contains an array with {mapped.ndim} axes; heights have 2, voxels 3.')
    check_size(path, mapped.size, max(mapped.dtype.itemsize, HEIGHT_BYTES if mapped.dtype.kind == "f" else 1))
    return Voxels(to_native_byte_order(path, np.array(mapped)))


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


def read_heights(path: Path, read_image: ReadImage | None = None) -> HeightMap:
    """Read a whole elevation model or image; the mean of colors is its height. read_image: as in `SourceContext`.

    Raises:
        FileError: it is none, is damaged, or does not fit into memory.
    """
    context = SourceContext(1.0, 1.0, read_image, SegmentCache(), accepts_colors=True, max_segment_bytes=MAX_BYTES)
    source = open_source(path, context)
    check_size(path, math.prod(source.shape), HEIGHT_BYTES)
    heights = np.empty(source.shape, np.float32)
    for rows in source.bands(CHUNK_SAMPLES):
        heights[rows] = source.read(rows, slice(0, source.shape[1]))
    bands = [heights[rows] for rows in source.bands(CHUNK_SAMPLES)]
    voids = find_voids(bands, source.void_heights, source.scale)
    for band in bands:
        mask_voids(band, voids)
    stretch = () if source.is_gray else warn_of_stretch(path, source.placement, source.shape)
    pixel_size = None if source.is_gray else ground_spacing(source.placement, source.shape)
    return HeightMap(heights, pixel_size, (*source.warnings, *stretch, *name_voids(path, voids)))


READERS: Readers = {
    ".npy": read_array,
    ".raw": read_raw,
    **dict.fromkeys((".asc", ".hgt", ".tif", ".tiff"), read_heights),
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
