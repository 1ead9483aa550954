"""Detection of EXR images that Blender did not write completely: it does not report every failed write."""

import struct
from pathlib import Path

import numpy as np

MAGIC = b"\x76\x2f\x31\x01"
CHUNK_HEADER = struct.Struct("<ii")  # first line of a chunk, and its size in bytes
DATA_WINDOW, COMPRESSION = b"dataWindow", b"compression"
LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16}  # by compression: none, RLE, ZIP of single lines, ZIP


def is_complete_exr(path: Path) -> bool:
    """Whether an EXR image of scan lines, uncompressed or with RLE or ZIP, has all its chunks up to its end. Raises OSError.

    The table after the header has the position of each chunk; a writer fills it last (OpenEXR file layout).
    """
    content = path.read_bytes()
    try:
        attributes, table_start = _read_header(content)
        _, low, _, high = struct.unpack("<4i", attributes[DATA_WINDOW])
        chunk_count = -(-(high - low + 1) // LINES_PER_CHUNK[attributes[COMPRESSION][0]])
        offsets = np.frombuffer(content, "<u8", chunk_count, table_start)
        last = int(offsets.max())
        _, size = CHUNK_HEADER.unpack_from(content, last)
    except (struct.error, ValueError, KeyError, IndexError):  # a part of the header or of the table is missing
        return False
    return bool((offsets >= table_start + offsets.nbytes).all()) and last + CHUNK_HEADER.size + size == len(content)


def _read_header(content: bytes) -> tuple[dict[bytes, bytes], int]:
    """Return the attributes by name and the position after the header. Raises ValueError or struct.error if it has no end."""
    if not content.startswith(MAGIC):
        raise ValueError
    attributes, position = {}, 8
    while content[position : position + 1] != b"\0":
        name_end = content.index(b"\0", position)
        type_end = content.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", content, type_end + 1)
        value_start = type_end + 5
        attributes[content[position:name_end]] = content[value_start : value_start + size]
        position = value_start + size
    return attributes, position + 1
