"""NumPy archives (.npz) in memory and in files. Untrusted files are read safely: any damage raises one of READ_ERRORS."""

import io
import math
import struct
import tokenize
import zipfile
import zlib
from typing import BinaryIO

import numpy as np

MAX_DEFLATE_RATIO = 1032  # of the size of data to its compressed size
READ_ERRORS = (
    OSError,
    ValueError,
    LookupError,
    ArithmeticError,
    EOFError,
    MemoryError,
    RuntimeError,  # an encrypted file, or an unknown compression method
    SyntaxError,  # a header that is not a Python literal
    tokenize.TokenError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
HEADER_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}  # by version of .npy


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
    content = io.BytesIO(archive.read(info))
    shape, _, dtype = HEADER_READERS[np.lib.format.read_magic(content)](content)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != info.file_size - content.tell():
        raise ValueError(f'the header of "{name}" is wrong')
    content.seek(0)
    return np.lib.format.read_array(content, allow_pickle=False)
