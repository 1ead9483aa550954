"""NumPy arrays in files: .npy files, and windows of arrays that a file holds row by row without compression."""

import tokenize
import zipfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import FileError
from .file_access import convert_os_errors

# What numpy.load raises for headers that are no Python literals, and for sizes that the file does not have.
NUMPY_ERRORS = (EOFError, OverflowError, SyntaxError, TypeError, ValueError, tokenize.TokenError, zipfile.BadZipFile)
MAX_HEADER_BYTES = 1 << 16  # NumPy refuses longer headers of .npy files, but reads them first.


def map_array(path: Path) -> np.ndarray:
    """Return the array of a .npy file, mapped, so that a header with a false size costs no memory.

    Raises:
        FileError: the file is truncated or damaged, is an archive, or contains Python objects.
    """
    with convert_os_errors(f'"{path}" cannot be read'), path.open("rb") as file:
        start = file.read(12)
    try:
        if start[6:7] > b"\1" and int.from_bytes(start[8:], "little") > MAX_HEADER_BYTES:
            raise ValueError("the header is too long")
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(mapped, np.ndarray):
            raise FileError(f'"{path}" is an archive, not a single array; save the array with numpy.save.')
    except NUMPY_ERRORS as error:
        raise FileError(f'"{path}" cannot be read as a NumPy array: it is truncated, damaged or not an array of numbers.') from error
    return mapped


MIN_WINDOW_FRACTION = 0.5  # Part of a row below which windows are read row by row, without the rest of the rows.


def read_raw_window(file: BinaryIO, offset: int, dtype: np.dtype, width: int, rows: slice, columns: slice) -> np.ndarray:
    """Return a window (h, w) of an array whose rows of `width` elements begin at `offset` in a file, in the byte order of `dtype`.

    Only the window is read, or its rows. Both slices have starts and stops within the array, and no steps.

    Raises:
        EOFError: the file is too short.
        OSError: it cannot be read.
    """
    shape = rows.stop - rows.start, columns.stop - columns.start
    if shape[1] >= MIN_WINDOW_FRACTION * width:
        values = np.empty((shape[0], width), dtype)
        _read_into(file, offset + rows.start * width * dtype.itemsize, values)
        return values[:, columns]
    window = np.empty(shape, dtype)
    for index, row in enumerate(window):
        _read_into(file, offset + ((rows.start + index) * width + columns.start) * dtype.itemsize, row)
    return window


def _read_into(file: BinaryIO, offset: int, values: np.ndarray) -> None:
    file.seek(offset)
    if file.readinto(values.reshape(-1).view(np.uint8)) < values.nbytes:
        raise EOFError("the file ends before its last sample")
