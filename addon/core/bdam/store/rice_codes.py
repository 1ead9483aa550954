"""Rice codes of integers that are mostly small, in arrays without a loop over values.

A value v is coded as the quotient v >> k and the lowest k bits. CHUNK values of a stream share the number k, which fits to their mean:
flat ground takes few bits, and steep ground next to it more (Rice and Plaunt, Adaptive variable-length coding for efficient compression of
spacecraft television data, 1971). A group of streams is coded as three parts, each filled up with zeros to whole bytes, lowest bits first:

1. k of all chunks, 5 bits each; 31 for a chunk of zeros, of which nothing else is stored
2. the quotients, each as that many zeros and a one
3. the lowest bits of all values with k > 0, then the second lowest ones of all values with k > 1, and so on
"""

from collections.abc import Sequence

import numpy as np

from ...errors import FileError

CHUNK = 64  # values
KEY_BITS, ZEROS = 5, 31
MAX_KEY = 30
CANDIDATES = (-2, -1, 0, 1)  # numbers k that are tried, relative to the logarithm of the mean


def encode_integers(streams: Sequence[np.ndarray]) -> bytes:
    """Encode streams (N,) of integers from 0 to 2**33."""
    values = np.concatenate(streams).astype(np.int64)
    starts, counts = _split([len(stream) for stream in streams])
    keys = _choose_keys(values, starts, counts)
    of_values = np.repeat(keys, counts)
    is_coded = of_values != ZEROS
    values, of_values = values[is_coded], of_values[is_coded]
    quotients = np.zeros(int((values >> of_values).sum()) + len(values), np.uint8)
    quotients[np.cumsum((values >> of_values) + 1) - 1] = 1
    planes = [(values[of_values > bit] >> bit & 1).astype(np.uint8) for bit in range(int(of_values.max(initial=0)))]
    key_bits = (keys[:, None] >> np.arange(KEY_BITS) & 1).astype(np.uint8)
    parts = (key_bits.ravel(), quotients, np.concatenate([np.zeros(0, np.uint8), *planes]))
    return b"".join(np.packbits(part, bitorder="little").tobytes() for part in parts)


def decode_integers(content: bytes, start: int, counts: Sequence[int]) -> tuple[list[np.ndarray], int]:
    """Return streams of `counts` integers, int64, from the position `start` in bytes, and the position after them.

    Raises:
        FileError: they are damaged.
    """
    _, chunks = _split(counts)
    bits = np.unpackbits(np.frombuffer(content, np.uint8, offset=start), bitorder="little")
    keys = _read_bits(bits, 0, KEY_BITS * len(chunks)).reshape(-1, KEY_BITS) @ (1 << np.arange(KEY_BITS))
    position = _align(KEY_BITS * len(chunks))
    of_values = np.repeat(keys, chunks)
    coded = np.flatnonzero(of_values != ZEROS)
    of_values = of_values[coded]
    ends = np.flatnonzero(bits[position:])[: len(coded)]
    if len(ends) != len(coded):
        raise FileError("a block is shorter than its contents.")
    values = np.diff(ends, prepend=-1) - 1 << of_values
    position = _align(position + (int(ends[-1]) + 1 if len(ends) else 0))
    for bit in range(int(of_values.max(initial=0))):
        members = np.flatnonzero(of_values > bit)
        values[members] |= _read_bits(bits, position, len(members)).astype(np.int64) << bit
        position += len(members)
    result = np.zeros(sum(counts), np.int64)
    result[coded] = values
    return np.split(result, np.cumsum(counts)[:-1]), start + _align(position) // 8


def to_unsigned(values: np.ndarray) -> np.ndarray:
    """Return integers (N,) int64 as integers from 0 on, those with small magnitudes first: 0, -1, 1, -2, ... (zigzag)."""
    values = values.astype(np.int64)
    return values << 1 ^ values >> 63


def to_signed(values: np.ndarray) -> np.ndarray:
    """Return the integers (N,) int64 that `to_unsigned` was given."""
    return values >> 1 ^ -(values & 1)


def _split(counts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return where the chunks (M,) of streams begin if the streams follow each other, and how many values they have, int64."""
    sizes = [np.full(-(-count // CHUNK), CHUNK, np.int64) for count in counts]
    for size, count in zip(sizes, counts, strict=True):
        size[-1:] -= len(size) * CHUNK - count
    lengths = np.concatenate(sizes)
    return np.cumsum(lengths) - lengths, lengths


def _choose_keys(values: np.ndarray, starts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the number k (M,) int64 of each chunk."""
    if not len(starts):
        return np.zeros(0, np.int64)
    sums = np.add.reduceat(values, starts)
    logarithms = np.log2(np.maximum(sums / counts, 1.0)).astype(np.int64)
    keys = np.clip(logarithms + np.array(CANDIDATES)[:, None], 0, MAX_KEY)
    bits = [np.add.reduceat(values >> np.repeat(candidate, counts), starts) + counts * candidate for candidate in keys]
    best = np.take_along_axis(keys, np.argmin(bits, axis=0)[None], axis=0)[0]
    return np.where(sums == 0, ZEROS, best)


def _read_bits(bits: np.ndarray, start: int, count: int) -> np.ndarray:
    """Return `count` bits (N,) uint8. Raises FileError if there are fewer."""
    if start + count > len(bits):
        raise FileError("a block is shorter than its contents.")
    return bits[start : start + count]


def _align(position: int) -> int:
    """Return the position in bits of the next whole byte."""
    return -(-position // 8) * 8
