"""Detection of files that Blender did not write completely.

Blender does not report every failed write: on a full disk, `.blend` files and images can be truncated without an error.
"""

import os
import struct
from pathlib import Path
from typing import BinaryIO

BLEND_MAGIC = b"BLENDER"
LARGE_BLOCK_VERSION = b"17"  # the size of the file header, in files of Blender 5.0 and later
BLOCK_HEADER_SIZE, LARGE_BLOCK_HEADER_SIZE = 24, 32
END_BLOCK = b"ENDB"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
SKIPPABLE_FRAME_MAGIC, SEEK_TABLE_MAGIC = 0x184D2A5E, 0x8F92EAB1
HAS_CHECKSUMS = 0x80
PNG_SIGNATURE, PNG_END = b"\x89PNG\r\n\x1a\n", b"\x00\x00\x00\x00IEND\xaeB`\x82"


def is_complete_blend(path: Path) -> bool:
    """Whether a `.blend` file, compressed or not, has its end and all its compressed frames. Its contents are not read. Raises OSError."""
    with path.open("rb") as file:
        header = file.read(len(BLEND_MAGIC) + len(LARGE_BLOCK_VERSION))
        if header.startswith(ZSTD_MAGIC):
            return _has_complete_seek_table(file)
        has_large_blocks = header.endswith(LARGE_BLOCK_VERSION)
        end = _read_end(file, LARGE_BLOCK_HEADER_SIZE if has_large_blocks else BLOCK_HEADER_SIZE)
        return header.startswith(BLEND_MAGIC) and end.startswith(END_BLOCK)


def is_complete_png(path: Path) -> bool:
    """Whether a PNG file has its beginning and its end. Raises OSError."""
    with path.open("rb") as file:
        return file.read(len(PNG_SIGNATURE)) == PNG_SIGNATURE and _read_end(file, len(PNG_END)) == PNG_END


def _has_complete_seek_table(file: BinaryIO) -> bool:
    """Whether a Zstandard file in the seekable format ends with a seek table whose frames fill the rest of the file."""
    footer_size = struct.calcsize("<IBI")
    footer = _read_end(file, footer_size)
    if len(footer) < footer_size:
        return False
    frame_count, descriptor, magic = struct.unpack("<IBI", footer)
    entry_size = 12 if descriptor & HAS_CHECKSUMS else 8
    content_size = frame_count * entry_size + footer_size
    table_size = struct.calcsize("<II") + content_size
    if magic != SEEK_TABLE_MAGIC or table_size > _size(file):
        return False
    table = _read_end(file, table_size)
    if struct.unpack_from("<II", table) != (SKIPPABLE_FRAME_MAGIC, content_size):
        return False
    frame_sizes = (struct.unpack_from("<I", table, 8 + index * entry_size)[0] for index in range(frame_count))
    return sum(frame_sizes) + table_size == _size(file)


def _read_end(file: BinaryIO, size: int) -> bytes:
    """Return the last `size` bytes of a file, or all of a smaller one."""
    file.seek(max(_size(file) - size, 0))
    return file.read(size)


def _size(file: BinaryIO) -> int:
    return file.seek(0, os.SEEK_END)
