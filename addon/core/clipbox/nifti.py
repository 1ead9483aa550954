"""Voxels from NIfTI-1 files, `.nii` and `.nii.gz` (nifti1.h of the NIfTI working group)."""

# Read by hand, not with nibabel: of all that such files tell only the array and the sides of its voxels are needed.

import gzip
import math
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import FileError
from .samples import Voxels, are_sides, check_size

HEADER = 348  # bytes
MOST_BEFORE_DATA = 2**26  # bytes of header and extensions; a gzip that asks for more has no good in mind
TYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4"}


def read_nifti(path: Path) -> Voxels:
    """The voxels of a NIfTI file, along x, y, z as they are stored, scaled as the header says; turns and shifts are left out.

    Raises:
        FileError: when it is none, is cut short, or holds something else than one block of voxels.
    """
    try:
        with gzip.open(path) if path.name.lower().endswith(".gz") else path.open("rb") as file:
            return _read(path, file)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise FileError(f'"{path}" is not a whole gzip file: {str(error).rstrip(".")}.') from error


def _read(path: Path, file: BinaryIO) -> Voxels:
    header = file.read(HEADER)
    order = next((sign for sign in "<>" if header[:4] == struct.pack(f"{sign}i", HEADER)), None)
    if order is None or len(header) < HEADER or header[344:348] != b"n+1\0":
        raise FileError(f'"{path}" does not begin as a NIfTI-1 file that holds its voxels itself; save it as one.')
    shape = _shape(path, struct.unpack_from(f"{order}8h", header, 40))
    code = struct.unpack_from(f"{order}h", header, 70)[0]
    if code not in TYPES:
        raise FileError(f'"{path}" holds voxels of NIfTI type {code}, which cannot be read; save it with 8 to 32 bits or as floats.')
    kind = np.dtype(order + TYPES[code])
    check_size(path, math.prod(shape), kind.itemsize)
    values = np.frombuffer(_data(path, file, header, order, math.prod(shape) * kind.itemsize), kind)
    values = values.astype(kind.newbyteorder("=")).reshape(shape, order="F")
    slope, shift = struct.unpack_from(f"{order}2f", header, 112)
    if math.isfinite(slope) and math.isfinite(shift) and slope != 0.0 and (slope, shift) != (1.0, 0.0):
        with np.errstate(over="ignore", invalid="ignore"):  # what is too large is no number
            values = values * np.float32(slope) + np.float32(shift)
    sides = struct.unpack_from(f"{order}3f", header, 80)
    return Voxels(values, sides) if are_sides(sides) else Voxels(values)


def _shape(path: Path, dimensions: tuple[int, ...]) -> tuple[int, int, int]:
    count, *sizes = dimensions
    if not 1 <= count <= 7 or min(sizes[:count]) < 1:
        raise FileError(f'"{path}" has a broken header: its voxels have no shape.')
    sizes = [*sizes[:count], 1, 1]
    if max(sizes[3:], default=1) > 1:
        raise FileError(f'"{path}" holds a series of blocks of voxels; save one of them by itself.')
    return tuple(sizes[:3])


def _data(path: Path, file: BinaryIO, header: bytes, order: str, size: int) -> bytes:
    """The bytes of the voxels."""
    begin = struct.unpack_from(f"{order}f", header, 108)[0]
    if not HEADER <= begin <= MOST_BEFORE_DATA:
        raise FileError(f'"{path}" has a broken header: its voxels would begin at byte {begin:g}.')
    file.seek(int(begin))
    data = file.read(size)
    if len(data) < size:
        raise FileError(f'"{path}" is cut short: it holds {len(data):,} bytes of voxels, not {size:,}.')
    return data
