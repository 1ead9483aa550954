"""NumPy archives (.npz) in memory and in files. Untrusted files are read safely: any damage raises one of READ_ERRORS."""

import io
import math
import re
import struct
import zipfile
import zlib
from typing import BinaryIO

import numpy as np

MAX_DEFLATE_RATIO = 1032  # The largest possible ratio of the size of data to its compressed size.
READ_ERRORS = (
    OSError,
    ValueError,
    LookupError,
    ArithmeticError,
    EOFError,
    MemoryError,
    RuntimeError,  # An encrypted file, or an unknown compression method.
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
# The header of a .npy file of version 1.0 with a plain data type. NumPy parses it with `ast`, which at times fails in several threads of
# Python 3.11 (CPython issue 106905).
HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '([<>|]?[a-zA-Z]\d{0,3})', 'fortran_order': (True|False), 'shape': \(([\d, ]*)\), \} *\n", re.DOTALL
)


def write_archive(arrays: dict[str, np.ndarray], *, compressed: bool = False) -> bytes:
    """Return the archive of `arrays`."""
    buffer = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    save(buffer, **arrays)
    return buffer.getvalue()


def read_archive(stream: BinaryIO, *names: str) -> list[np.ndarray]:
    """Return the arrays called `names`. Other arrays are not read. `stream` may have other bytes before the archive.

    Raises one of READ_ERRORS if the archive is damaged. Nothing is allocated that is larger than the file itself can hold.
    """
    size = stream.seek(0, io.SEEK_END)
    with zipfile.ZipFile(stream) as archive:
        return [_read_array(archive, name, size) for name in names]


def _read_array(archive: zipfile.ZipFile, name: str, file_size: int) -> np.ndarray:
    info = archive.getinfo(f"{name}.npy")
    ratio = 1 if info.compress_type == zipfile.ZIP_STORED else MAX_DEFLATE_RATIO
    if info.file_size > ratio * min(info.compress_size, file_size):
        raise ValueError(f'the size of "{name}" is wrong')
    content = archive.read(info)
    header = HEADER.match(content)
    if header is None:
        raise ValueError(f'the header of "{name}" is wrong')
    dtype = np.dtype(header[1].decode("ascii"))
    shape = tuple(int(count) for count in header[3].split(b",") if count.strip())
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(content) - header.end():
        raise ValueError(f'the header of "{name}" is wrong')
    order = "F" if header[2] == b"True" else "C"
    return np.frombuffer(content, dtype, offset=header.end()).reshape(shape, order=order).copy(order)
