"""Bytes of sections of mesh.bin: raw DEFLATE (RFC 1951) of symbols, extra bits and LEB128 integers.

A residual is a symbol and extra bits. Residuals 0, -1, 1, -2 ... are the numbers n = 0, 1, 2, 3 ... A number below 8 is its symbol. Of a
larger one with k + 3 bits, the symbol is 4 + 4 k plus the two bits behind the first one, and the k bits behind these are extra bits.
"""

import zlib
from collections.abc import Iterable

import numpy as np

from ...arrays import concatenate_ranges

STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_FILTERED, zlib.Z_HUFFMAN_ONLY, zlib.Z_RLE)


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


def encode_residuals(residuals: np.ndarray) -> tuple[bytes, bytes]:
    """Return the symbols and the extra bits of `residuals` (N, C), integers modulo 65536: those of one column after those of another."""
    signed = residuals.T.reshape(-1).astype(np.int16).astype(np.int64)
    numbers = (signed << 1) ^ (signed >> 15)
    counts = np.maximum(np.frexp(numbers.astype(np.float64))[1] - 3, 0)
    symbols = np.where(counts, 4 * counts + (numbers >> counts), numbers)
    bits = np.repeat(numbers, counts) >> concatenate_ranges(0, counts) & 1
    return symbols.astype(np.uint8).tobytes(), np.packbits(bits.astype(np.uint8), bitorder="little").tobytes()


def encode_integers(values: Iterable[int]) -> bytes:
    """Return nonnegative integers as LEB128: seven bits per byte, the lowest first; the highest bit says that more follow."""
    result = bytearray()
    for value in values:
        while value >= 128:
            result.append(value & 127 | 128)
            value >>= 7
        result.append(value)
    return bytes(result)


def encode_signed(value: int) -> int:
    """Return 0, 1, 2, 3 ... for 0, -1, 1, -2 ..."""
    return 2 * value if value >= 0 else -2 * value - 1
