"""Symbols of the scans of progressive JPEG files (Annex G of the standard), of many tiles at once.

A scan of DC coefficients has all components; a scan of AC coefficients one component and a band of its coefficients. The first scan of a
band gives magnitudes without their lowest bits, each later one refines them by a bit.
"""

from typing import NamedTuple

import numpy as np

RUN_OF_ZEROS = 0xF0  # the symbol for 16 zeros
BIT_LENGTHS = np.concatenate([[0], np.floor(np.log2(np.arange(1, 1 << 15))).astype(np.int64) + 1])
RAW = -1  # instead of a symbol: bits alone
# What a coefficient contributes, in this order.
END_RUN, END_CORRECTIONS, FIRST_ZEROS, ZEROS_CORRECTIONS, MORE_ZEROS, COEFFICIENT, CORRECTIONS = range(7)
KINDS = 8  # one more for the end of a tile


class ScanSymbols(NamedTuple):
    """Symbols (N,) int64, each with additional bits: values (N,) int64 and lengths (N,) int64; and the tile (N,) int64, ascending.

    tables: (N,) int64, 1 for DC coefficients of Cb and Cr, otherwise 0.
    """

    symbols: np.ndarray
    values: np.ndarray
    lengths: np.ndarray
    tiles: np.ndarray
    tables: np.ndarray


def list_dc_symbols(coefficients: np.ndarray) -> ScanSymbols:
    """Return the symbols of the scan of DC `coefficients` (C, N, B) int16 of N tiles."""
    components, tiles, blocks = coefficients.shape
    differences = np.diff(coefficients.astype(np.int64), axis=2, prepend=0).transpose(1, 2, 0).ravel()
    sizes = BIT_LENGTHS[np.abs(differences)]
    tables = np.tile(np.minimum(np.arange(components), 1), tiles * blocks)
    return ScanSymbols(sizes, _sign_bits(differences, sizes), sizes, np.repeat(np.arange(tiles), blocks * components), tables)


def list_ac_symbols(coefficients: np.ndarray, shift: int) -> ScanSymbols:
    """Return the symbols of the first scan of a band of `coefficients` (N, B, K) int16 of N tiles, without `shift` of their lowest bits."""
    tiles, blocks, width = coefficients.shape
    magnitudes = (np.abs(coefficients) >> shift).ravel()
    items = np.flatnonzero(magnitudes)
    owners, places = np.divmod(items, width)
    is_first = np.diff(owners, prepend=-1) > 0
    runs = places - np.where(is_first, 0, np.roll(places, 1) + 1)
    sizes = BIT_LENGTHS[magnitudes[items]]
    signed = np.where(coefficients.ravel()[items] < 0, -1, 1) * magnitudes[items].astype(np.int64)
    zeros = runs >> 4
    parts = [
        (np.repeat(items * KINDS + FIRST_ZEROS, zeros), *_no_bits(int(zeros.sum()), RUN_OF_ZEROS)),
        (items * KINDS + COEFFICIENT, (runs & 15) << 4 | sizes, _sign_bits(signed, sizes), sizes),
    ]
    ends = _list_end_runs(items[is_first], owners[is_first], _ends_early(owners, places, tiles * blocks, width), blocks, width)
    return _merge([*parts, ends[0]], blocks * width)


def list_ac_corrections(coefficients: np.ndarray, shift: int) -> ScanSymbols:
    """Return the symbols of a scan that refines a band of `coefficients` (N, B, K) int16 of N tiles by the bit `shift`."""
    tiles, blocks, width = coefficients.shape
    magnitudes = (np.abs(coefficients) >> shift).ravel()
    items = np.flatnonzero(magnitudes)
    owners, places = np.divmod(items, width)
    is_new = magnitudes[items] == 1
    count = np.arange(len(items))
    block_start = np.maximum.accumulate(np.where(np.diff(owners, prepend=-1) > 0, count, 0)) if len(items) else count
    zeros = places - (count - block_start)  # in the block before each item
    # A coefficient that becomes nonzero ends a segment. Runs of 16 zeros within it are written before the next nonzero coefficient.
    previous_new = np.maximum.accumulate(np.concatenate([[-1], np.where(is_new, count, -1)]))[:-1]
    has_previous = previous_new >= block_start
    since = zeros - np.where(has_previous, zeros[np.maximum(previous_new, 0)] if len(items) else 0, 0)
    is_segment_start = (count == block_start) | (previous_new == count - 1)
    zero_runs = (since >> 4) - np.where(is_segment_start, 0, np.roll(since >> 4, 1))
    last_new = np.full(tiles * blocks, -1, np.int64)
    last_new[owners[is_new]] = count[is_new]  # of repeated indices the last one is stored
    is_before_end = count <= last_new[owners]
    zero_runs = np.where(is_before_end, zero_runs, 0)
    is_event = (zero_runs > 0) | is_new
    # The correction bit of a coefficient follows the next symbol of its block; without one it follows the end of the block.
    events = np.where(is_event, count, len(items))
    next_event = np.concatenate([np.minimum.accumulate(events[::-1])[::-1][1:], [len(items)]]) if len(items) else events
    is_old = ~is_new
    inner = np.flatnonzero(is_old & is_before_end)
    target = next_event[inner]
    inner_kinds = np.where(zero_runs[target] > 0, ZEROS_CORRECTIONS, CORRECTIONS)
    corrections = (magnitudes[items] & 1).astype(np.int64)
    many = np.maximum(zero_runs - 1, 0)
    new = np.flatnonzero(is_new)
    signs = (coefficients.ravel()[items[new]] > 0).astype(np.int64)
    parts = [
        (items[zero_runs > 0] * KINDS + FIRST_ZEROS, *_no_bits(int((zero_runs > 0).sum()), RUN_OF_ZEROS)),
        (items[target] * KINDS + inner_kinds, *_raw_bits(corrections[inner])),
        (np.repeat(items * KINDS + MORE_ZEROS, many), *_no_bits(int(many.sum()), RUN_OF_ZEROS)),
        (items[new] * KINDS + COEFFICIENT, (since[new] & 15) << 4 | 1, signs, np.ones_like(signs)),
    ]
    event_items = np.flatnonzero(is_event)
    first_events = event_items[np.diff(owners[event_items], prepend=-1) > 0]
    early = _ends_early(owners[new], places[new], tiles * blocks, width)
    ends, key_of_block = _list_end_runs(items[first_events], owners[first_events], early, blocks, width)
    tail = np.flatnonzero(is_old & ~is_before_end)
    parts += [ends, (key_of_block[owners[tail]] - END_RUN + END_CORRECTIONS, *_raw_bits(corrections[tail]))]
    return _merge(parts, blocks * width)


def _ends_early(owners: np.ndarray, places: np.ndarray, block_count: int, width: int) -> np.ndarray:
    """Return which blocks need the end of a block: (blocks,) bool, those whose last coefficient has no symbol."""
    is_early = np.ones(block_count, bool)
    is_early[owners[places == width - 1]] = False
    return is_early


def _list_end_runs(
    first_items: np.ndarray, busy_blocks: np.ndarray, is_early: np.ndarray, blocks: int, width: int
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Return the symbols of runs of ends of blocks, and for each block the key of the run that its end belongs to.

    A run is written before the next block with symbols, the last one at the end of the tile.

    Args:
        first_items: (M,) the first coefficient with a symbol of each of the `busy_blocks` (M,), which have symbols. is_early: (N B,) bool.
    """
    block_count = len(is_early)
    ends_before = np.concatenate([[0], np.cumsum(is_early)])
    last = np.arange(blocks, block_count + 1, blocks)  # the block after each tile
    places = np.concatenate([busy_blocks, last])
    keys = np.concatenate([first_items * KINDS + END_RUN, last * width * KINDS - KINDS + END_RUN])
    # The run at the end of a tile comes behind all symbols of its last coefficient: it replaces nothing of the same key.
    keys[len(busy_blocks) :] += CORRECTIONS
    order = np.lexsort((keys, places))
    places, keys = places[order], keys[order]
    lengths = np.diff(ends_before[places], prepend=0)
    key_of_block = keys[np.searchsorted(places, np.arange(block_count), side="right")]
    is_run = lengths > 0
    sizes = BIT_LENGTHS[lengths[is_run]] - 1
    return (keys[is_run], sizes << 4, lengths[is_run] - (1 << sizes), sizes), key_of_block


def _sign_bits(values: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the additional bits of `values`, whose magnitudes have `sizes` bits."""
    return np.where(values < 0, values + (1 << sizes) - 1, values)


def _no_bits(count: int, symbol: int) -> tuple[np.ndarray, ...]:
    return np.full(count, symbol, np.int64), np.zeros(count, np.int64), np.zeros(count, np.int64)


def _raw_bits(bits: np.ndarray) -> tuple[np.ndarray, ...]:
    return np.full(len(bits), RAW, np.int64), bits, np.ones(len(bits), np.int64)


def _merge(parts: list[tuple[np.ndarray, ...]], tile_items: int) -> ScanSymbols:
    """Return the symbols of `parts` (keys, symbols, values, lengths) in the order of their keys."""
    keys, symbols, values, lengths = (np.concatenate([part[column] for part in parts]) for column in range(4))
    order = np.argsort(keys, kind="stable")
    return ScanSymbols(symbols[order], values[order], lengths[order], keys[order] // (tile_items * KINDS), np.zeros(len(order), np.int64))
