"""Rice codes of integers that are mostly small, in arrays without a loop over values.

A value v is coded as the quotient v >> k and the lowest k bits. CHUNK values of a stream share the number k, which fits to their mean:
flat ground takes few bits, and steep ground next to it more (Rice and Plaunt, Adaptive variable-length coding for efficient compression of
spacecraft television data, 1971). A group of streams is coded as three parts, each filled up with zeros to whole bytes, lowest bits first:

1. k of all chunks, 5 bits each; 31 for a chunk of zeros, of which nothing else is stored
2. the quotients, each as that many zeros and a one
3. the lowest bits of all values with k > 0, then the second lowest ones of all values with k > 1, and so on
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...arrays import concatenate_ranges, to_starts
from ...errors import FileError

CHUNK = 64  # values
KEY_BITS, ZEROS = 5, 31
TOO_SHORT = "a block is shorter than its contents."
MAX_KEY = 30
CANDIDATES = (-2, -1, 0, 1)  # numbers k that are tried, relative to the logarithm of the mean


def encode_integers(streams: Sequence[np.ndarray], counts: np.ndarray) -> list[bytes]:
    """Return the groups of blocks (P,).

    Args:
        streams: S arrays of integers from 0 to 2**33, those of all blocks, one after the other. counts: (P, S) their numbers.
    """
    values = np.empty(int(counts.sum()), np.int64)
    for stream, rows in zip(streams, _stream_rows(counts), strict=True):
        values[rows] = stream
    chunks = _split(counts.ravel())
    keys = _choose_keys(values, np.cumsum(chunks) - chunks, chunks)
    of_values = np.repeat(keys, chunks)
    coded = np.flatnonzero(of_values != ZEROS)
    values, of_values = values[coded], of_values[coded]
    of_blocks = np.searchsorted(coded, to_starts(counts.sum(axis=1)))  # where the coded values of each block begin
    unary = (values >> of_values) + 1
    # The first bit of each of the three parts of a block.
    key_bits = KEY_BITS * (-(-counts // CHUNK)).sum(axis=1)
    parts = np.stack([key_bits, *(np.diff(to_starts(bits)[of_blocks]) for bits in (unary, of_values))], axis=1)
    starts = 8 * to_starts(-(-parts.ravel() // 8))
    positions = starts[:-1].reshape(parts.shape).T.copy()
    bits = np.zeros(int(starts[-1]), np.uint8)
    bits[concatenate_ranges(positions[0], key_bits)] = (keys[:, None] >> np.arange(KEY_BITS) & 1).ravel()
    sums = to_starts(unary)
    bits[sums[1:] - 1 + np.repeat(positions[1] - sums[of_blocks[:-1]], np.diff(of_blocks))] = 1
    members, place = np.arange(len(values)), positions[2]
    for bit in range(int(of_values.max(initial=0))):
        members = members[of_values[members] > bit]
        of_bit = np.diff(np.searchsorted(members, of_blocks))
        bits[concatenate_ranges(place, of_bit)] = values[members] >> bit & 1
        place += of_bit
    content = np.packbits(bits, bitorder="little").tobytes()
    return [content[start:end] for start, end in pairwise((starts[:: parts.shape[1]] // 8).tolist())]


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
        return [result[rows] for rows in _stream_rows(counts)]

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


def _stream_rows(counts: np.ndarray) -> list[np.ndarray]:
    """Return where the values of S streams are if those of (P, S) counts follow each other by blocks, then by streams."""
    starts = to_starts(counts.ravel())[:-1].reshape(counts.shape)
    return [concatenate_ranges(first, count) for first, count in zip(starts.T, counts.T, strict=True)]


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
