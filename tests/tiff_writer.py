"""A writer of TIFF files for tests, with the compressions and predictors that tifffile cannot write alone (TIFF Revision 6.0; BigTIFF)."""

import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

COMPRESSIONS = {"none": 1, "lzw": 5, "deflate": 8, "old_deflate": 32946, "packbits": 32773, "zstd": 50000}
FORMATS = {3: "H", 4: "I", 7: "B", 12: "d", 16: "Q"}  # types of tags: short, long, bytes, double, long8
SAMPLE_FORMATS = {"u": 1, "i": 2, "f": 3}
POINT_KEYS = (1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 2, 2048, 0, 1, 4326)  # degrees, pixel-is-point
AREA_KEYS = (1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326)  # degrees, pixel-is-area
UTM_KEYS = (1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32632, 3076, 0, 1, 9001)  # meters, pixel-is-area


def compress_lzw(data: bytes, max_entries: int = 4094) -> bytes:
    """Compress with the table of strings that TIFF 6.0, section 13 describes. The table is cleared when it has `max_entries`;
    it remains as it is if these are more than the 4,096 that codes can name."""
    codes, table = [(256, 9)], {}
    last_entry, string = 257, b""

    def write(string: bytes) -> None:
        codes.append((table[string] if len(string) > 1 else string[0], min((last_entry + 1).bit_length(), 12)))

    for value in data:
        longer = string + bytes([value])
        if len(longer) == 1 or longer in table:
            string = longer
            continue
        write(string)
        if last_entry < 4095:
            last_entry += 1
            table[longer] = last_entry
        string = bytes([value])
        if last_entry + 1 >= max_entries:
            codes.append((256, (last_entry + 1).bit_length()))
            table.clear()
            last_entry = 257
    if string:
        write(string)
        last_entry += 1
    codes.append((257, min((last_entry + 1).bit_length(), 12)))
    bits = "".join(format(code, f"0{width}b") for code, width in codes)
    bits += "0" * (-len(bits) % 8)
    return int(bits, 2).to_bytes(len(bits) // 8, "big")


def compress_pack_bits(data: bytes) -> bytes:
    """Compress runs of equal bytes and of others (TIFF 6.0, section 9)."""
    packed, position = bytearray(), 0
    while position < len(data):
        length = 1
        while length < 128 and data[position + length : position + length + 1] == data[position : position + 1]:
            length += 1
        if length > 1:
            packed += bytes([257 - length, data[position]])
        else:
            while length < 128 and position + length < len(data) and data[position + length] != data[position + length - 1]:
                length += 1
            packed += bytes([length - 1]) + data[position : position + length]
        position += length
    return bytes(packed)


def compress_zstandard(data: bytes) -> bytes:
    """Compress with Zstandard (RFC 8878); the test is skipped where its package is missing."""
    return pytest.importorskip("zstandard").ZstdCompressor().compress(data)


COMPRESSORS: Mapping[str, Callable[[bytes], bytes]] = {
    "none": bytes,
    "lzw": compress_lzw,
    "deflate": zlib.compress,
    "old_deflate": zlib.compress,
    "packbits": compress_pack_bits,
    "zstd": compress_zstandard,
}


def apply_predictor(values: np.ndarray, predictor: int, order: str) -> bytes:
    """Return the bytes of samples (rows, columns, channels) after predictor 1, 2 (TIFF 6.0, section 14) or 3 (Technical Note 3)."""
    if predictor == 3:
        big_endian = np.ascontiguousarray(values, values.dtype.newbyteorder(">")).view(np.uint8)
        planes = big_endian.reshape(len(values), -1, values.itemsize).transpose(0, 2, 1).reshape(len(values), -1, values.shape[2])
        return np.concatenate([planes[:, :1], np.diff(planes, axis=1)], axis=1).astype(np.uint8).tobytes()
    if predictor == 2:
        unsigned = np.ascontiguousarray(values).view(f"u{values.itemsize}")
        values = np.concatenate([unsigned[:, :1], np.diff(unsigned, axis=1)], axis=1)
    return values.astype(values.dtype.newbyteorder(order)).tobytes()


def write_tiff(
    path: Path,
    values: np.ndarray,
    compression: str = "none",
    predictor: int = 1,
    tile: tuple[int, int] | None = None,
    rows_per_strip: int = 16,
    order: str = "<",
    big: bool = False,
    tags: Mapping[int, tuple] = (),
    empty: tuple[int, ...] = (),
    mask: np.ndarray | None = None,
    encode: Callable[[np.ndarray], bytes] | None = None,
) -> Path:
    """Write an image (H, W) or (H, W, C).

    tile: rows and columns of tiles, None for strips. big: as BigTIFF. tags: further ones, (type, values) or text by number. empty: indices
    of segments that are not stored. mask: (H, W) bool, a second image with single bits, in one strip. encode: codes segments (h, w, C)
    instead of the compression, whose number is then in `tags`.
    """
    image = values.reshape(*values.shape[:2], -1)
    rows, columns, channels = image.shape
    segment_rows, segment_columns = tile or (rows_per_strip, columns)
    if tile:
        image = np.pad(image, ((0, -rows % tile[0]), (0, -columns % tile[1]), (0, 0)), mode="edge")
    segments = []
    for top in range(0, rows, segment_rows):
        for left in range(0, columns, segment_columns):
            segment = image[top : top + segment_rows, left : left + segment_columns]
            is_coded = encode is not None
            segments.append(encode(segment) if is_coded else COMPRESSORS[compression](apply_predictor(segment, predictor, order)))
    segments = [b"" if index in empty else segment for index, segment in enumerate(segments)]
    header = 16 if big else 8
    starts = np.cumsum([header, *(len(segment) for segment in segments)]).tolist()
    offsets = tuple(0 if index in empty else start for index, start in enumerate(starts[:-1]))
    counts = tuple(len(segment) for segment in segments)
    entries: dict[int, tuple] = {
        256: (4, (columns,)),
        257: (4, (rows,)),
        258: (3, (8 * values.itemsize,) * channels),
        259: (3, (COMPRESSIONS[compression],)),
        262: (3, (1,)),
        277: (3, (channels,)),
        317: (3, (predictor,)),
        339: (3, (SAMPLE_FORMATS[values.dtype.kind],) * channels),
        **({322: (4, (tile[1],)), 323: (4, (tile[0],))} if tile else {278: (4, (rows_per_strip,))}),
        (324 if tile else 273): (16 if big else 4, offsets),
        (325 if tile else 279): (16 if big else 4, counts),
        **dict(tags),
    }
    content = b"".join(segments)
    start = header + len(content)
    directory = _directory(entries, order, big, start)
    if mask is not None:
        bits = COMPRESSORS[compression](np.packbits(mask, axis=1).tobytes())
        second = start + len(directory) + len(bits)
        directory = _directory(entries, order, big, start, second) + bits
        directory += _directory(_mask_entries(mask, compression, second - len(bits), len(bits)), order, big, second)
    path.write_bytes(_header(order, big, start) + content + directory)
    return path


def _mask_entries(mask: np.ndarray, compression: str, offset: int, size: int) -> dict[int, tuple]:
    numbers = {254: 4, 256: mask.shape[1], 257: mask.shape[0], 258: 1, 262: 4, 277: 1, 278: mask.shape[0], 273: offset, 279: size}
    return {259: (3, (COMPRESSIONS[compression],)), **{code: (4, (number,)) for code, number in numbers.items()}}


def map_tags(
    pixel: tuple[float, float], north_west: tuple[float, float], keys: tuple[int, ...] = UTM_KEYS, no_data: str | None = None
) -> dict[int, tuple]:
    """Return the tags of a map: pixel size, raster origin, geo keys and GDAL's number for unknown heights."""
    tags = {33550: (12, (*pixel, 0.0)), 33922: (12, (0.0, 0.0, 0.0, *north_west, 0.0)), 34735: (3, keys)}
    return tags if no_data is None else {**tags, 42113: (2, no_data)}


def _header(order: str, big: bool, directory: int) -> bytes:
    mark = b"II" if order == "<" else b"MM"
    return mark + (struct.pack(f"{order}3HQ", 43, 8, 0, directory) if big else struct.pack(f"{order}HI", 42, directory))


def _directory(entries: dict[int, tuple], order: str, big: bool, start: int, following: int = 0) -> bytes:
    word, inline = ("Q", 8) if big else ("I", 4)
    size = struct.calcsize(f"{order}{'Q' if big else 'H'}") + len(entries) * (4 + 2 * inline) + inline
    table, extra = struct.pack(f"{order}{'Q' if big else 'H'}", len(entries)), b""
    for code, (kind, numbers) in sorted(entries.items()):
        data = numbers.encode() + b"\0" if kind == 2 else struct.pack(f"{order}{len(numbers)}{FORMATS[kind]}", *numbers)
        count = len(data) if kind == 2 else len(numbers)
        table += struct.pack(f"{order}2H{word}", code, kind, count)
        if len(data) <= inline:
            table += data.ljust(inline, b"\0")
        else:
            table += struct.pack(f"{order}{word}", start + size + len(extra))
            extra += data + b"\0" * (len(data) % 2)
    return table + struct.pack(f"{order}{word}", following) + extra
