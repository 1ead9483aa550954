"""Windows of arrays that a file holds row by row without compression."""

from typing import BinaryIO

import numpy as np

MIN_WINDOW_FRACTION = 0.5  # of a row; narrower windows are read row by row, so that the rest of the rows is not


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
