"""Bytes of sections of mesh.bin: raw DEFLATE (RFC 1951) of symbols, extra bits and LEB128 integers.

A residual is a symbol and extra bits. Residuals 0, -1, 1, -2 ... are the numbers n = 0, 1, 2, 3 ... A number below 8 is its symbol. Of a
larger one with k + 3 bits, the symbol is 4 + 4 k plus the two bits behind the first one, and the k bits behind these are extra bits.
"""

import zlib
from collections.abc import Iterable

import numpy as np

from ...arrays import concatenate_ranges
from ...errors import FileError

MAX_RATIO = 1032  # of DEFLATE: bytes from one byte
STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_FILTERED, zlib.Z_HUFFMAN_ONLY, zlib.Z_RLE)
MAX_LEB128_BYTES = 5
MAX_SYMBOL = 59  # of a residual: 16 bits, of which 13 are extra
MAX_RESIDUAL_BYTES = 3  # symbol and extra bits, rounded up


def deflate(*parts: bytes) -> bytes:
    """Return the content of all `parts` compressed: together or each in DEFLATE blocks of its own, whatever is smaller."""
    separate = [_compress(part, zlib.Z_SYNC_FLUSH) for part in parts[:-1]]
    return min(b"".join([*separate, _compress(parts[-1], zlib.Z_FINISH)]), _compress(b"".join(parts), zlib.Z_FINISH), key=len)


def _compress(part: bytes, end: int) -> bytes:
    """Return the result of the strategy that makes `part` smallest. end: how zlib ends it."""
    candidates = []
    for strategy in STRATEGIES:
        coder = zlib.compressobj(9, zlib.DEFLATED, -15, 9, strategy)
        candidates.append(coder.compress(part) + coder.flush(end))
    return min(candidates, key=len)


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


def encode_residuals(residuals: np.ndarray) -> tuple[bytes, bytes]:
    """Return the symbols and the extra bits of `residuals` (N, C), integers modulo 65536: those of one column after those of another."""
    signed = residuals.T.reshape(-1).astype(np.int16).astype(np.int64)
    numbers = (signed << 1) ^ (signed >> 15)
    counts = np.maximum(np.frexp(numbers.astype(np.float64))[1] - 3, 0)
    symbols = np.where(counts, 4 * counts + (numbers >> counts), numbers)
    bits = np.repeat(numbers, counts) >> concatenate_ranges(0, counts) & 1
    return symbols.astype(np.uint8).tobytes(), np.packbits(bits.astype(np.uint8), bitorder="little").tobytes()


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
