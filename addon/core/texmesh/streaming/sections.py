"""Bytes of sections of mesh.bin: raw DEFLATE (RFC 1951) of byte planes and of LEB128 integers."""

import zlib
from collections.abc import Iterable

import numpy as np

from ...errors import FileError

MAX_RATIO = 1032  # of DEFLATE: bytes from one byte
STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_FILTERED, zlib.Z_HUFFMAN_ONLY, zlib.Z_RLE)
MAX_LEB128_BYTES = 5


def deflate(content: bytes) -> bytes:
    """Return `content` compressed by the strategy that makes it smallest."""
    results = []
    for strategy in STRATEGIES:
        coder = zlib.compressobj(9, zlib.DEFLATED, -15, 9, strategy)
        results.append(coder.compress(content) + coder.flush())
    return min(results, key=len)


def inflate(content: bytes | memoryview, max_size: int) -> bytes:
    """Return what `deflate` compressed, at most `max_size` bytes.

    Raises:
        FileError: it is damaged, or larger.
    """
    try:
        decoder = zlib.decompressobj(-15)
        result = decoder.decompress(content, max_size + 1)
    except zlib.error as error:
        raise damage() from error
    if len(result) > max_size or not decoder.eof:
        raise damage()
    return result


def damage() -> FileError:
    """Return the error for meshes that cannot be decoded."""
    return FileError("The mesh of the package is damaged; export the package again, or copy it again.")


def encode_residuals(residuals: np.ndarray) -> bytes:
    """Return `residuals` (N, C) integers modulo 65536, those near 0 as small numbers, as byte planes: low and high byte of each column."""
    signed = residuals.astype(np.int16).astype(np.int32)
    zigzag = ((signed << 1) ^ (signed >> 15)).astype("<u2")
    return np.ascontiguousarray(zigzag.view(np.uint8).T).tobytes()


def decode_residuals(content: bytes, columns: int) -> np.ndarray:
    """Return the residuals (N, columns) int64 that `encode_residuals` encoded, -32768 to 32767."""
    planes = np.frombuffer(content, np.uint8).reshape(2 * columns, -1)
    zigzag = np.ascontiguousarray(planes.T).view("<u2").astype(np.int64)
    return (zigzag >> 1) ^ -(zigzag & 1)


def encode_integers(values: Iterable[int]) -> bytes:
    """Return nonnegative integers as LEB128: seven bits per byte, the lowest first; the highest bit says that more follow."""
    result = bytearray()
    for value in values:
        while value >= 128:
            result.append(value & 127 | 128)
            value >>= 7
        result.append(value)
    return bytes(result)


class IntegerReader:
    """Reads integers that `encode_integers` encoded, one after the other."""

    def __init__(self, content: bytes, offset: int) -> None:
        self._content, self._offset = content, offset

    def read(self) -> int:
        """Return the next integer.

        Raises:
            FileError: there is none, or it is longer than 32 bits.
        """
        value = shift = 0
        while True:
            if self._offset >= len(self._content) or shift >= 7 * MAX_LEB128_BYTES:
                raise damage()
            byte = self._content[self._offset]
            self._offset += 1
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7

    @property
    def is_at_end(self) -> bool:
        return self._offset == len(self._content)


def encode_signed(value: int) -> int:
    """Return 0, 1, 2, 3 ... for 0, -1, 1, -2 ..."""
    return 2 * value if value >= 0 else -2 * value - 1


def decode_signed(value: int) -> int:
    """Return the integer that `encode_signed` encoded."""
    return -(value + 1) // 2 if value & 1 else value // 2
