"""The content of the sections of mesh.bin: the inverse of `core.packages.mesh.sections`."""

import zlib

import numpy as np

from farfield.addon.core.arrays import concatenate_ranges
from farfield.addon.core.errors import FileError

MAX_RATIO = 1032  # Bytes that DEFLATE can make of one byte.
MAX_LEB128_BYTES = 5
MAX_SYMBOL = 59  # The symbol of a residual with 16 bits, 13 of which are extra.
MAX_RESIDUAL_BYTES = 3  # symbol and extra bits, rounded up


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


def decode_residuals(content: bytes, rows: int, columns: int) -> np.ndarray:
    """Return the residuals (rows, columns) int64, -32768 to 32767, from symbols and extra bits, one after the other.

    Raises:
        FileError: there are too few or too many bytes, or a symbol that does not exist.
    """
    if len(content) < rows * columns:
        raise damage()
    symbols = np.frombuffer(content, np.uint8, rows * columns).astype(np.int64)
    counts = np.maximum(symbols // 4 - 1, 0)
    if len(content) - len(symbols) != -(-int(counts.sum()) // 8) or symbols.max(initial=0) > MAX_SYMBOL:
        raise damage()
    bits = np.unpackbits(np.frombuffer(content, np.uint8, offset=len(symbols)), count=int(counts.sum()), bitorder="little")
    owners, positions = np.repeat(np.arange(len(symbols)), counts), concatenate_ranges(0, counts)
    extra = np.bincount(owners, bits.astype(np.int64) << positions, len(symbols)).astype(np.int64)
    numbers = np.where(counts, (4 + symbols % 4 << counts) + extra, symbols)
    return ((numbers >> 1) ^ -(numbers & 1)).reshape(columns, rows).T


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


def decode_signed(value: int) -> int:
    """Return the integer that `encode_signed` encoded."""
    return -(value + 1) // 2 if value & 1 else value // 2
