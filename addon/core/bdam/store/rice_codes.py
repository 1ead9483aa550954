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

from ...arrays import concatenate_ranges, to_starts
from ...errors import FileError

CHUNK = 64  # values
KEY_BITS, ZEROS = 5, 31
TOO_SHORT = "a block is shorter than its contents."
MAX_KEY = 30
CANDIDATES = (-2, -1, 0, 1)  # numbers k that are tried, relative to the logarithm of the mean


def encode_integers(streams: Sequence[np.ndarray]) -> bytes:
    """Encode streams (N,) of integers from 0 to 2**33."""
    values = np.concatenate(streams).astype(np.int64)
    counts = _split(np.array([len(stream) for stream in streams]))
    keys = _choose_keys(values, np.cumsum(counts) - counts, counts)
    of_values = np.repeat(keys, counts)
    is_coded = of_values != ZEROS
    values, of_values = values[is_coded], of_values[is_coded]
    quotients = np.zeros(int((values >> of_values).sum()) + len(values), np.uint8)
    quotients[np.cumsum((values >> of_values) + 1) - 1] = 1
    planes = [(values[of_values > bit] >> bit & 1).astype(np.uint8) for bit in range(int(of_values.max(initial=0)))]
    key_bits = (keys[:, None] >> np.arange(KEY_BITS) & 1).astype(np.uint8)
    parts = (key_bits.ravel(), quotients, np.concatenate([np.zeros(0, np.uint8), *planes]))
    return b"".join(np.packbits(part, bitorder="little").tobytes() for part in parts)


class RiceReader:
    """Reads groups of streams from blocks that have as many streams, from all of them at once."""

    def __init__(self, contents: Sequence[bytes], start: int) -> None:
        """contents: blocks (P,). start: where the first group begins in each, in bytes."""
        self._bits = np.unpackbits(np.frombuffer(b"".join(contents), np.uint8), bitorder="little")
        self._ones = np.flatnonzero(self._bits)
        ends = 8 * to_starts(np.array([len(content) for content in contents]))
        self._starts, self._ends = ends[:-1], ends[1:]
        self._positions = self._starts + 8 * start

    def read(self, counts: np.ndarray) -> list[np.ndarray]:
        """Return the streams of the next group of `counts` (P, S) integers, int64: S arrays of those of all blocks, one after the other.

        Raises:
            FileError: a block is damaged.
        """
        chunks, of_blocks = _split(counts.ravel()), counts.sum(axis=1)
        keys = self._take(KEY_BITS * (-(-counts // CHUNK)).sum(axis=1)).reshape(-1, KEY_BITS) @ (1 << np.arange(KEY_BITS))
        self._align()
        of_values = np.repeat(keys, chunks)
        coded = np.flatnonzero(of_values != ZEROS)
        of_values = of_values[coded]
        starts = np.searchsorted(coded, to_starts(of_blocks))
        values = self._take_quotients(starts) << of_values
        members = np.arange(len(coded))
        for bit in range(int(of_values.max(initial=0))):
            members = members[of_values[members] > bit]
            values[members] |= self._take(np.diff(np.searchsorted(members, starts))).astype(np.int64) << bit
        self._align()
        result = np.zeros(int(of_blocks.sum()), np.int64)
        result[coded] = values
        of_streams = to_starts(counts.ravel())[:-1].reshape(counts.shape)
        return [result[concatenate_ranges(first, count)] for first, count in zip(of_streams.T, counts.T, strict=True)]

    def find_bytes(self) -> list[int]:
        """Return the positions in bytes after the last group, in each block."""
        return ((self._positions - self._starts) // 8).tolist()

    def _take(self, counts: np.ndarray) -> np.ndarray:
        """Return the next `counts` (P,) bits of the blocks (N,) uint8. Raises FileError if there are fewer."""
        positions = self._positions
        self._advance(counts)
        return self._bits[concatenate_ranges(positions, counts)]

    def _take_quotients(self, starts: np.ndarray) -> np.ndarray:
        """Return the next quotients of the blocks (N,) int64, those of a block from `starts` (P + 1,) on. Raises FileError."""
        counts = np.diff(starts)
        first = np.searchsorted(self._ones, self._positions)
        if (first + counts > len(self._ones)).any():
            raise FileError(TOO_SHORT)
        ends = self._ones[concatenate_ranges(first, counts)]
        quotients = np.diff(ends, prepend=0) - 1
        filled = counts > 0
        quotients[starts[:-1][filled]] = ends[starts[:-1][filled]] - self._positions[filled]
        lengths = np.zeros(len(counts), np.int64)
        lengths[filled] = ends[starts[1:][filled] - 1] + 1 - self._positions[filled]
        self._advance(lengths)
        self._align()
        return quotients

    def _advance(self, counts: np.ndarray) -> None:
        """Move on by `counts` (P,) bits. Raises FileError if there are fewer."""
        self._positions = self._positions + counts
        if (self._positions > self._ends).any():
            raise FileError(TOO_SHORT)

    def _align(self) -> None:
        """Move on to the next whole bytes."""
        self._positions = -(-self._positions // 8) * 8


def to_unsigned(values: np.ndarray) -> np.ndarray:
    """Return integers (N,) int64 as integers from 0 on, those with small magnitudes first: 0, -1, 1, -2, ... (zigzag)."""
    values = values.astype(np.int64)
    return values << 1 ^ values >> 63


def to_signed(values: np.ndarray) -> np.ndarray:
    """Return the integers (N,) int64 that `to_unsigned` was given."""
    return values >> 1 ^ -(values & 1)


def _split(counts: np.ndarray) -> np.ndarray:
    """Return how many values the chunks (M,) of streams of `counts` (S,) values have, int64."""
    chunks = -(-counts // CHUNK)
    lengths = np.full(int(chunks.sum()), CHUNK, np.int64)
    lengths[np.cumsum(chunks)[counts > 0] - 1] -= (chunks * CHUNK - counts)[counts > 0]
    return lengths


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
