"""Voxels from NIfTI-1 files, `.nii` and `.nii.gz` (nifti1.h of the NIfTI working group)."""

# Not read with nibabel: only the array and the voxel sizes of such files are needed.

import gzip
import math
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import FileError
from ...files.height_maps import CHUNK_SAMPLES, are_valid_sizes, check_size, to_native_byte_order
from .file_data import Voxels

HEADER_BYTES = 348
MAX_DATA_OFFSET = 2**26  # bytes of header and extensions; larger offsets in a gzip file are malicious
MAX_COMPRESSION = 1100  # bytes per byte of a gzip file; deflate reaches 1032
DTYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4"}


def read_nifti(path: Path) -> Voxels:
    """Read the voxels of a NIfTI file along x, y, z as stored, scaled as the header declares. Rotation and translation are ignored.

    Raises:
        FileError: it is not a NIfTI-1 file, is truncated, or does not contain a single volume.
    """
    try:
        with gzip.open(path) if path.name.lower().endswith(".gz") else path.open("rb") as file:
            return _read(path, file)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise FileError(f'"{path}" is not a complete gzip file: {str(error).rstrip(".")}.') from error


def _read(path: Path, file: BinaryIO) -> Voxels:
    header = file.read(HEADER_BYTES)
    byte_order = next((order for order in "<>" if header[:4] == struct.pack(f"{order}i", HEADER_BYTES)), None)
    if byte_order is None or len(header) < HEADER_BYTES or header[344:348] != b"n+1\0":
        raise FileError(f'"{path}" is not a NIfTI-1 file that contains its voxels; export it as a single .nii file.')
    shape = _parse_shape(path, struct.unpack_from(f"{byte_order}8h", header, 40))
    type_code = struct.unpack_from(f"{byte_order}h", header, 70)[0]
    if type_code not in DTYPES:
        raise FileError(f'"{path}" contains voxels of the unsupported NIfTI type {type_code}; save it with 8 to 32 bits or as floats.')
    dtype = np.dtype(byte_order + DTYPES[type_code])
    scale, offset = struct.unpack_from(f"{byte_order}2f", header, 112)
    is_scaled = math.isfinite(scale) and math.isfinite(offset) and scale != 0.0 and (scale, offset) != (1.0, 0.0)
    check_size(path, math.prod(shape), _scaled_dtype(dtype).itemsize if is_scaled else dtype.itemsize)
    values = _read_voxels(path, file, header, byte_order, math.prod(shape), dtype).reshape(shape, order="F")
    values = _scale(values, scale, offset) if is_scaled else to_native_byte_order(path, values)
    sizes = struct.unpack_from(f"{byte_order}3f", header, 80)
    return Voxels(values, sizes) if are_valid_sizes(sizes) else Voxels(values)


def _parse_shape(path: Path, dimensions: tuple[int, ...]) -> tuple[int, int, int]:
    axis_count, *sizes = dimensions
    if not 1 <= axis_count <= 7 or min(sizes[:axis_count]) < 1:
        raise FileError(f'"{path}" has an invalid header: its voxels have no shape.')
    sizes = [*sizes[:axis_count], 1, 1]
    if max(sizes[3:], default=1) > 1:
        raise FileError(f'"{path}" contains a series of volumes; save one of them as a separate file.')
    return tuple(sizes[:3])


def _read_voxels(path: Path, file: BinaryIO, header: bytes, byte_order: str, count: int, dtype: np.dtype) -> np.ndarray:
    """Return the voxels (N,) in the order of the file."""
    offset, byte_count = struct.unpack_from(f"{byte_order}f", header, 108)[0], count * dtype.itemsize
    if not HEADER_BYTES <= offset <= MAX_DATA_OFFSET:
        raise FileError(f'"{path}" has an invalid header: its voxels would begin at byte {offset:g}.')
    if byte_count > path.stat().st_size * MAX_COMPRESSION:
        raise FileError(f'"{path}" is truncated: its {path.stat().st_size:,} bytes cannot contain {byte_count:,} bytes of voxels.')
    file.seek(int(offset))
    values = np.empty(count, dtype)
    target, filled = memoryview(values.view(np.uint8)), 0
    while filled < byte_count and (read := file.readinto(target[filled : filled + CHUNK_SAMPLES])):
        filled += read
    if filled < byte_count:
        raise FileError(f'"{path}" is truncated: it contains {filled:,} bytes of voxels instead of {byte_count:,}.')
    return values


def _scaled_dtype(dtype: np.dtype) -> np.dtype:
    """Return the type of scaled voxels: single precision, or double where the integers need it."""
    return np.result_type(dtype, np.float32)


def _scale(values: np.ndarray, scale: float, offset: float) -> np.ndarray:
    """Return `values` (X, Y, Z) times `scale` plus `offset`."""
    scaled = np.empty(values.shape, _scaled_dtype(values.dtype))
    with np.errstate(over="ignore", invalid="ignore"):  # overflowing values become invalid
        np.multiply(values, np.float32(scale), out=scaled)
        np.add(scaled, np.float32(offset), out=scaled)
    return scaled
