"""Tiles as progressive JPEG files that share their header, Huffman tables included: a scan is nothing but its parameters and its bits.

Libraries choose Huffman tables per scan, which for small tiles takes up to a tenth of the bytes, and have one order of scans. Here, all
tiles of a texture share tables, and the order of scans is chosen per tile.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .huffman import SYMBOLS, HuffmanTable, build_table, pack_bits
from .scan_symbols import (
    BIT_LENGTHS,
    RAW,
    RUN_OF_ZEROS,
    ScanSymbols,
    list_ac_corrections,
    list_ac_symbols,
    list_dc_symbols,
)

DC_TABLES = 2  # of Y, and of Cb and Cr
AC_TABLES = 4
LOW_LUMINANCE, HIGH_LUMINANCE, CHROMINANCE, REFINEMENT = range(AC_TABLES)
LUMINANCE_BANDS = ((1, 5), (6, 20), (21, 63))  # first and last coefficient, in zigzag order
CHROMINANCE_BANDS = ((1, 5), (6, 63))
MAX_SHIFT = 1  # bits that the first scan of a band of AC coefficients leaves out; more of them cost contrast, or bytes
JFIF = bytes.fromhex("ffe000104a46494600010100000100010000")


@dataclass(frozen=True)
class Scan:
    """What a scan adds: of `component`, None for all of them, coefficients `first` to `last` in zigzag order, down to the bit `shift`.

    The first scan of a band has all bits above too; later ones add a bit each. Tiles whose coefficients are small begin with a lower bit:
    they have fewer scans, and no scan of a band that is zero. Decoders take such a band as not yet known, and smooth steps between blocks
    without other coefficients. table: for the first scan of AC coefficients.
    """

    component: int | None
    first: int
    last: int
    shift: int
    table: int


def list_scans(component_count: int) -> list[Scan]:
    """Return the possible scans of a tile. Those of a band stand one after the other, in the order that JPEG demands."""
    scans = [Scan(None, 0, 0, 0, 0)]
    for component in range(component_count):
        for index, (first, last) in enumerate(CHROMINANCE_BANDS if component else LUMINANCE_BANDS):
            table = CHROMINANCE if component else (HIGH_LUMINANCE if index else LOW_LUMINANCE)
            scans += [Scan(component, first, last, shift, table) for shift in range(MAX_SHIFT, -1, -1)]
    return scans


def find_first_shifts(quantized: np.ndarray, scans: Sequence[Scan]) -> np.ndarray:
    """Return the bit (K, N) int64 of the first scan of the band of each of K scans, for tiles `quantized` (C, N, B, 64) int16; -1 where all
    coefficients are zero."""
    tops = np.empty((len(scans), quantized.shape[1]), np.int64)
    for index, scan in enumerate(scans):
        if scan.component is None:
            tops[index] = 0
        else:
            largest = np.abs(quantized[scan.component, :, :, scan.first : scan.last + 1]).max(axis=(1, 2))
            tops[index] = np.minimum(BIT_LENGTHS[largest] - 1, MAX_SHIFT)
    return tops


def list_symbols(quantized: np.ndarray, scan: Scan, refines: bool) -> ScanSymbols:
    """Return the symbols of a scan of tiles `quantized` (C, N, B, 64) int16; `refines` unless it is the first one of its band."""
    if scan.component is None:
        return list_dc_symbols(quantized[..., 0])
    band = np.ascontiguousarray(quantized[scan.component, :, :, scan.first : scan.last + 1])
    return list_ac_corrections(band, scan.shift) if refines else list_ac_symbols(band, scan.shift)


def build_tables(samples: np.ndarray, max_magnitudes: np.ndarray, scans: Sequence[Scan]) -> list[HuffmanTable]:
    """Return the Huffman tables of a texture: DC_TABLES, and AC_TABLES. Every symbol that can occur has a code.

    Args:
        samples: (C, N, B, 64) int16, tiles whose symbols decide how long codes are. max_magnitudes: (C, 64) of all tiles.
    """
    components, _, blocks = samples.shape[:3]
    counts = np.zeros((DC_TABLES + AC_TABLES, SYMBOLS), np.int64)
    ends = np.arange(BIT_LENGTHS[blocks]) << 4
    first_shifts = find_first_shifts(samples, scans)
    for scan, tops in zip(scans, first_shifts, strict=True):
        if scan.component is None:
            for table, largest in enumerate((max_magnitudes[:1, 0], max_magnitudes[1:, 0])[: min(components, DC_TABLES)]):
                counts[table, : BIT_LENGTHS[2 * int(largest.max()) + 1] + 1] += 1
        else:
            largest = int(max_magnitudes[scan.component, scan.first : scan.last + 1].max()) >> scan.shift
            runs = np.arange(min(16, scan.last - scan.first + 1)) << 4
            for table, size in ((scan.table, int(BIT_LENGTHS[largest])), (REFINEMENT, 1)):
                symbols = runs[:, None] | np.arange(1, size + 1)
                possible = np.unique(np.concatenate([symbols.ravel(), ends, [RUN_OF_ZEROS]]))
                counts[DC_TABLES + table, possible] = np.maximum(counts[DC_TABLES + table, possible], 1)
        for refines, chosen in _split_tiles(scan, tops):
            found = list_symbols(samples[:, chosen], scan, refines)
            is_coded = found.symbols != RAW
            places = _find_tables(found, scan, refines)[is_coded] * SYMBOLS + found.symbols[is_coded]
            counts += np.bincount(places, minlength=counts.size).reshape(counts.shape)
    return [build_table(row) for row in counts]


def code_scan(quantized: np.ndarray, scan: Scan, tops: np.ndarray, tables: Sequence[HuffmanTable]) -> list[bytes]:
    """Return a scan of each of the tiles `quantized` (C, N, B, 64) int16, empty for those that do not have it.

    tops: (N,) the bit of the first scan of the band, see `find_first_shifts`.
    """
    codes = np.stack([table.codes for table in tables]).ravel()
    lengths = np.stack([table.lengths for table in tables]).ravel()
    parts = [b""] * quantized.shape[1]
    for refines, chosen in _split_tiles(scan, tops):
        tiles = np.flatnonzero(chosen)
        symbols = list_symbols(quantized[:, tiles], scan, refines)
        is_coded = symbols.symbols != RAW
        places = np.where(is_coded, _find_tables(symbols, scan, refines) * SYMBOLS + symbols.symbols, 0)
        code = np.where(is_coded, codes[places], 0) << symbols.lengths | symbols.values
        bit_counts = np.where(is_coded, lengths[places], 0) + symbols.lengths
        start = _start_of_scan(scan, refines, len(quantized))
        for tile, part in zip(tiles.tolist(), pack_bits(code, bit_counts, symbols.tiles, len(tiles)), strict=True):
            parts[tile] = start + part
    return parts


def _split_tiles(scan: Scan, tops: np.ndarray) -> list[tuple[bool, np.ndarray]]:
    """Return which tiles (N,) bool have the scan as the first one of its band, and which of them as a later one."""
    groups = [(False, tops == scan.shift), (True, tops > scan.shift)]
    return [group for group in groups if group[1].any()]


def _find_tables(symbols: ScanSymbols, scan: Scan, refines: bool) -> np.ndarray:
    """Return the table (N,) of each symbol: of DC coefficients, and behind them of AC coefficients."""
    if scan.component is None:
        return symbols.tables
    return np.full(len(symbols.symbols), DC_TABLES + (REFINEMENT if refines else scan.table))


def write_header(side: int, steps: np.ndarray, tables: Sequence[HuffmanTable]) -> bytes:
    """Return the header of tiles of `side` pixels: quantization `steps` (C, 64), frame and Huffman `tables`."""
    components = len(steps)
    parts = [b"\xff\xd8", JFIF]
    for index, row in enumerate(steps[: min(components, 3)]):
        parts.append(_segment(0xDB, bytes([index]) + bytes(row.astype(np.uint8))))
    frame = bytes([8]) + side.to_bytes(2, "big") * 2 + bytes([components])
    frame += b"".join(bytes([index + 1, 0x11, index]) for index in range(components))
    parts.append(_segment(0xC2, frame))
    for index, table in enumerate(tables):
        if len(table.stored) > 16:
            number = index if index < DC_TABLES else 0x10 | (index - DC_TABLES)
            parts.append(_segment(0xC4, bytes([number]) + table.stored))
    return b"".join(parts)


def _segment(marker: int, content: bytes) -> bytes:
    return bytes([0xFF, marker]) + (len(content) + 2).to_bytes(2, "big") + content


def _start_of_scan(scan: Scan, refines: bool, components: int) -> bytes:
    numbers = range(components) if scan.component is None else [scan.component]
    content = bytes([len(numbers)])
    for number in numbers:
        table = min(number, 1) << 4 if scan.component is None else (REFINEMENT if refines else scan.table)
        content += bytes([number + 1, table])
    return _segment(0xDA, content + bytes([scan.first, scan.last, (scan.shift + 1 if refines else 0) << 4 | scan.shift]))
