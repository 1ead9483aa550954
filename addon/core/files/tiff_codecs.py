"""Compressions and predictors of TIFF segments: deflate, LZW, PackBits, Zstandard, and the predictors 2 and 3.

tifffile has neither LZW nor predictor 3 without the package imagecodecs, which the extension does not include.

Sources: TIFF Revision 6.0, sections 9 (PackBits), 13 (LZW) and 14 (predictor 2); Adobe Photoshop TIFF Technical Note 3 (predictor 3).
Zstandard, RFC 8878, has a number in libtiff only.
"""

import math
import zlib

import numpy as np

NONE, LZW, DEFLATE, OLD_DEFLATE, PACK_BITS, ZSTANDARD = 1, 5, 8, 32946, 32773, 50000  # values of the tag Compression
HORIZONTAL, FLOATING_POINT = 2, 3  # values of the tag Predictor; 1 for none
MAX_RATIOS = {NONE: 1, LZW: 2731, DEFLATE: 1040, OLD_DEFLATE: 1040, PACK_BITS: 64, ZSTANDARD: 1 << 16}  # decoded bytes per byte, at most
CLEAR, END, FIRST_ENTRY = 256, 257, 258  # LZW codes
WIDTH_STARTS = np.array([0, 254, 766, 1790])  # numbers of codes after a Clear at which they become 10, 11 and 12 bits wide
FIRST_CODES = 4096  # codes that are extracted at once; most writers clear the table after about 3,840


def decode_segment(data: bytes, compression: int, predictor: int, shape: tuple[int, int, int], dtype: np.dtype) -> np.ndarray:
    """Return the samples (rows, columns, channels) of a compressed strip or tile, in the byte order of this machine.

    dtype: as stored, with its byte order; bool for single bits, whose rows begin at whole bytes.

    Raises:
        ValueError, zlib.error: the segment is damaged, or too short.
    """
    if dtype.kind == "b":
        bits = shape[1] * shape[2]
        packed = np.frombuffer(decompress(data, compression, shape[0] * -(-bits // 8)), np.uint8).reshape(shape[0], -1)
        return np.unpackbits(packed, axis=1, count=bits).view(bool).reshape(shape)
    decoded = decompress(data, compression, math.prod(shape) * dtype.itemsize)
    if predictor == FLOATING_POINT:
        return undo_float_predictor(decoded, shape, dtype)
    values = np.frombuffer(decoded, dtype).reshape(shape).astype(dtype.newbyteorder("="), copy=False)
    return undo_predictor(values) if predictor == HORIZONTAL else values


def decompress(data: bytes, compression: int, size: int) -> bytes:
    """Return `size` bytes of a compressed segment.

    Raises:
        ValueError, zlib.error: it is damaged, or ends before.
    """
    if size > len(data) * MAX_RATIOS[compression]:
        raise ValueError("a segment is too short for its pixels")
    if compression == NONE:
        return data[:size]
    if compression == LZW:
        decoded = decompress_lzw(data, size)
    elif compression == PACK_BITS:
        decoded = decompress_pack_bits(data, size)
    elif compression == ZSTANDARD:
        decoded = decompress_zstandard(data, size)
    else:
        decoded = zlib.decompressobj().decompress(data, size)
    if len(decoded) < size:
        raise ValueError("a segment ends before its last pixel")
    return decoded


def decompress_pack_bits(data: bytes, size: int) -> bytes:
    """Return at most `size` bytes of a PackBits segment (TIFF 6.0, section 9): runs of equal bytes, and runs of different ones."""
    decoded, position = bytearray(), 0
    while position < len(data) and len(decoded) < size:
        count = data[position]
        if count < 128:
            decoded += data[position + 1 : position + count + 2]
            position += count + 2
        else:
            if count > 128:
                decoded += data[position + 1 : position + 2] * (257 - count)
            position += 2 if count > 128 else 1
    return bytes(decoded[:size])


def decompress_zstandard(data: bytes, size: int) -> bytes:
    """Return at most `size` bytes of a Zstandard segment. Raises ValueError if it is damaged, or the package zstandard is missing."""
    try:
        import zstandard  # Blender includes it
    except ImportError as error:
        raise ValueError("COMPRESSION.ZSTD requires the package zstandard") from error
    try:
        return zstandard.ZstdDecompressor().stream_reader(data).read(size)
    except zstandard.ZstdError as error:
        raise ValueError("a Zstandard segment is damaged") from error


def decompress_lzw(data: bytes, size: int) -> bytes:
    """Return at most `size` bytes of an LZW segment (TIFF 6.0, section 13): codes of 9 to 12 bits, most significant bit first.

    The table of strings is never built. The entry that the k-th code after a Clear defines is the string of the code before it and one byte
    more, and these are the very bytes that were written at the time. So every code copies bytes that were decoded before, and all codes
    between two Clears are decoded at once: the copies are followed back to single bytes by doubling.

    Raises:
        ValueError: a code refers to an entry that does not exist.
    """
    padded = np.concatenate([np.frombuffer(data, np.uint8), np.zeros(4, np.uint8)]).astype(np.uint32)
    words = padded[:-3] << 24 | padded[1:-2] << 16 | padded[2:-1] << 8 | padded[3:]  # the 32 bits from every byte on
    parts, bit, decoded_size = [], 0, 0
    while decoded_size < size:
        codes, bit = _read_lzw_codes(words, bit, 8 * len(data))
        if codes.size:
            part = _decode_lzw_codes(codes, size - decoded_size)
            parts.append(part)
            decoded_size += len(part)
        if bit < 0:
            break
    return b"".join(parts)[:size]


def _read_lzw_codes(words: np.ndarray, bit: int, bit_count: int) -> tuple[np.ndarray, int]:
    """Return the codes (K,) int64 from the position `bit` to the next Clear, and the position after it, -1 at the end of the data."""
    count = FIRST_CODES
    while True:
        widths = 9 + np.searchsorted(WIDTH_STARTS, np.arange(count), side="right") - 1
        ends = bit + np.cumsum(widths)
        complete = int(np.searchsorted(ends, bit_count, side="right"))
        starts, widths = (ends - widths)[:complete], widths[:complete]
        codes = words[starts >> 3].astype(np.int64) >> (32 - (starts & 7) - widths) & (1 << widths) - 1
        stops = np.flatnonzero((codes == CLEAR) | (codes == END))
        if stops.size:
            first = int(stops[0])
            return codes[:first], -1 if codes[first] == END else int(ends[first])
        if complete < count:
            return codes, -1  # some writers omit the last code
        count *= 2  # the table is full and the writer goes on with it


def _decode_lzw_codes(codes: np.ndarray, size: int) -> bytes:
    """Return the bytes of the codes (K,) between two Clears, at least `size` of them if there are as many."""
    index = np.arange(len(codes))
    entries = codes - FIRST_ENTRY
    is_literal = codes < CLEAR
    if (entries >= index).any() or not is_literal[0]:
        raise ValueError("an LZW code has no entry")
    sources = np.where(is_literal, index, entries)
    lengths, roots = np.where(is_literal, 0, 1), sources
    while (steps := lengths[roots]).any():
        lengths, roots = lengths + steps, roots[roots]
    lengths += 1
    positions = np.cumsum(lengths) - lengths
    used = int(np.searchsorted(positions, size))  # what the image does not need is not decoded
    codes, lengths, positions, sources = codes[:used], lengths[:used], positions[:used], sources[:used]
    shifts = np.repeat((positions[sources] - positions).astype(np.int32), lengths)  # 0 of literals
    origins = np.arange(len(shifts), dtype=np.int32) + shifts
    while not np.array_equal(further := origins[origins], origins):
        origins = further
    literals = np.repeat((codes & 255).astype(np.uint8), lengths)  # only those of literal codes are looked up
    return literals[origins].tobytes()


def undo_predictor(values: np.ndarray) -> np.ndarray:
    """Return samples (rows, columns, channels) that predictor 2 has stored: as differences to the pixel before (TIFF 6.0, section 14).

    values: in the byte order of this machine. The bits of floats are differences of integers.
    """
    unsigned = values.view(f"u{values.itemsize}")
    return np.cumsum(unsigned, axis=1, dtype=unsigned.dtype).view(values.dtype)


def undo_float_predictor(data: bytes, shape: tuple[int, int, int], dtype: np.dtype) -> np.ndarray:
    """Return floats (rows, columns, channels) that predictor 3 has stored: the bytes of every row of pixels, the most significant bytes of
    all samples first, as differences to the byte of the pixel before (Technical Note 3).
    """
    rows, columns, channels = shape
    differences = np.frombuffer(data, np.uint8).reshape(rows, columns * dtype.itemsize, channels)
    planes = np.cumsum(differences, axis=1, dtype=np.uint8).reshape(rows, dtype.itemsize, columns * channels)
    big_endian = np.ascontiguousarray(planes.transpose(0, 2, 1)).view(dtype.newbyteorder(">"))
    return big_endian.reshape(shape).astype(dtype.newbyteorder("="))
