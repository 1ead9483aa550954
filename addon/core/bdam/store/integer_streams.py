"""Streams of integers as bytes that compress well: planes of equal significance, as many as the largest value needs."""

import numpy as np

from ...errors import FileError

WIDTHS = (0, 1, 2, 4)  # bytes of a value


def write_unsigned(values: np.ndarray) -> bytes:
    """Encode integers (N,) from 0 to 2**32 - 1: one byte with the width, then the planes from the lowest byte to the highest."""
    largest = int(values.max(initial=0))
    width = next(width for width in WIDTHS if largest < 1 << 8 * width)
    planes = values.astype("<u4").view(np.uint8).reshape(-1, 4).T[:width]
    return bytes([width]) + planes.tobytes()


def write_signed(values: np.ndarray) -> bytes:
    """Encode integers (N,) from -2**31 to 2**31 - 1, with small magnitudes first (zigzag)."""
    values = values.astype(np.int64)
    return write_unsigned(np.where(values < 0, -2 * values - 1, 2 * values))


class StreamReader:
    """Reads the streams of one block from the beginning."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._position = 0

    def read_bytes(self, count: int) -> np.ndarray:
        """Return the next `count` bytes, uint8.

        Raises:
            FileError: the block ends before.
        """
        end = self._position + count
        if end > len(self._content):
            raise FileError("a block is shorter than its contents.")
        start, self._position = self._position, end
        return np.frombuffer(self._content, np.uint8, count, start)

    def read_unsigned(self, count: int) -> np.ndarray:
        """Return the next stream of `count` integers, int64."""
        width = int(self.read_bytes(1)[0])
        if width not in WIDTHS:
            raise FileError("a block contains a stream of an unknown width.")
        planes = self.read_bytes(width * count)
        if not width:
            return np.zeros(count, np.int64)
        values = planes[:count].astype(np.int64)
        for plane in range(1, width):
            values |= planes[plane * count : (plane + 1) * count].astype(np.int64) << 8 * plane
        return values

    def read_signed(self, count: int) -> np.ndarray:
        """Return the next stream of `count` signed integers, int64."""
        values = self.read_unsigned(count)
        return (values >> 1) ^ -(values & 1)
