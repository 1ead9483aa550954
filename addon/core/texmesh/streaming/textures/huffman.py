"""Huffman codes of JPEG, and the bits of many files at once."""

import heapq
from typing import NamedTuple

import numpy as np

MAX_LENGTH = 16  # bits of a code
SYMBOLS = 256


class HuffmanTable(NamedTuple):
    """Codes (256,) int64 and their lengths (256,) int64 in bits, 0 for symbols without a code; and the table as JPEG stores it: how many
    codes of each length, and their symbols."""

    codes: np.ndarray
    lengths: np.ndarray
    stored: bytes


def build_table(counts: np.ndarray) -> HuffmanTable:
    """Return the best table for symbols that occur `counts` (256,) times; those with 0 have no code.

    No code consists of ones only, as JPEG demands (Annex K.2 of the standard).
    """
    symbols = np.flatnonzero(counts)
    heap = [(int(counts[symbol]), index, (index,)) for index, symbol in enumerate(symbols)]
    heap.append((0, len(symbols), (len(symbols),)))  # stands for the code of ones only
    heapq.heapify(heap)
    lengths = np.zeros(len(symbols) + 1, np.int64)
    ties = len(heap)
    while len(heap) > 1:
        (first_count, _, first), (second_count, _, second) = heapq.heappop(heap), heapq.heappop(heap)
        lengths[list(first + second)] += 1
        heapq.heappush(heap, (first_count + second_count, ties, first + second))
        ties += 1
    by_length = _limit_lengths(np.bincount(lengths, minlength=2 * MAX_LENGTH + 1))
    by_length[np.flatnonzero(by_length)[-1]] -= 1
    order = symbols[np.lexsort((symbols, lengths[:-1]))]
    codes, code_lengths = np.zeros(SYMBOLS, np.int64), np.zeros(SYMBOLS, np.int64)
    code, used = 0, 0
    for length in range(1, MAX_LENGTH + 1):
        for symbol in order[used : used + by_length[length]]:
            codes[symbol], code_lengths[symbol] = code, length
            code += 1
        used += by_length[length]
        code <<= 1
    stored = bytes(by_length[1 : MAX_LENGTH + 1].astype(np.uint8)) + bytes(order.astype(np.uint8))
    return HuffmanTable(codes, code_lengths, stored)


def _limit_lengths(by_length: np.ndarray) -> np.ndarray:
    """Return numbers of codes by length in which none is longer than MAX_LENGTH."""
    by_length = by_length.copy()
    for length in range(len(by_length) - 1, MAX_LENGTH, -1):
        while by_length[length] > 0:
            shorter = length - 2
            while by_length[shorter] == 0:
                shorter -= 1
            by_length[length] -= 2
            by_length[length - 1] += 1
            by_length[shorter + 1] += 2
            by_length[shorter] -= 1
    return by_length


def pack_bits(values: np.ndarray, lengths: np.ndarray, owners: np.ndarray, count: int) -> list[bytes]:
    """Return `count` byte strings of the bits of `values` (N,), `lengths` (N,) 0 to 32 bits each, most significant first.

    owners: (N,) ascending, which of the strings each value belongs to. Strings are filled with ones to whole bytes, and each byte FF is
    followed by 00, as JPEG demands.
    """
    bits = np.bincount(owners, lengths, minlength=count).astype(np.int64)
    fills = -bits % 8
    starts = np.concatenate([[0], np.cumsum(bits + fills)])
    offsets = np.cumsum(lengths) - lengths + np.concatenate([[0], np.cumsum(fills)])[owners]
    all_offsets = np.concatenate([offsets, starts[1:] - fills])
    all_values = np.concatenate([values, (1 << fills) - 1]).astype(np.uint64)
    all_lengths = np.concatenate([lengths, fills])
    words, shifts = all_offsets >> 5, 64 - (all_offsets & 31) - all_lengths
    shifted = all_values << np.minimum(shifts, 63).astype(np.uint64)
    word_count = int(starts[-1] // 32 + 2)
    packed = np.bincount(words, (shifted >> np.uint64(32)).astype(np.float64), minlength=word_count)
    packed += np.bincount(words + 1, (shifted & np.uint64(0xFFFFFFFF)).astype(np.float64), minlength=word_count)[:word_count]
    content = packed.astype(np.uint64).astype(">u4").view(np.uint8)[: starts[-1] // 8]
    stuffed = np.flatnonzero(content == 0xFF)
    borders = starts // 8 + np.searchsorted(stuffed, starts // 8)
    content = np.insert(content, stuffed + 1, 0).tobytes()
    return [content[start:stop] for start, stop in zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True)]
