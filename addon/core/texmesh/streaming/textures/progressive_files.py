"""Progressive JPEG files as a header and scans: any number of the first scans with an end is a file that every decoder reads."""

from collections.abc import Sequence

import numpy as np

from ....errors import FileError, ImageError
from ....imaging.coded_images import decode

SOI, EOI = b"\xff\xd8", b"\xff\xd9"
SOF2, DHT, SOS = 0xC2, 0xC4, 0xDA
STANDALONE = {0x01, *range(0xD0, 0xD8)}  # markers without a length: TEM and restart markers


def split_scans(content: bytes) -> tuple[bytes, list[bytes]]:
    """Return the header of a progressive JPEG file, up to the first Huffman table or scan, and its scans, each with the tables before it.

    Raises:
        FileError: the file is damaged, truncated or not progressive.
    """
    if content[:2] != SOI:
        raise FileError("A tile of a texture is no JPEG file; export the package again.")
    header_end, marker, position = 0, 0, 2
    is_progressive = False
    while not header_end:
        marker, end = _read_marker(content, position)
        is_progressive |= marker == SOF2
        if marker in (DHT, SOS):
            header_end = position
        position = end
    if not is_progressive:
        raise FileError("A tile of a texture is no progressive JPEG file; export the package again.")
    scans, position = [], header_end
    while content[position : position + 2] != EOI:
        end = _find_scan_end(content, position)
        scans.append(content[position:end])
        position = end
    return content[:header_end], scans


def check_increment(content: bytes | memoryview, scan_count: int) -> None:
    """Raise FileError unless `content` consists of `scan_count` scans with the tables before them."""
    content, position = bytes(content), 0
    for _ in range(scan_count):
        position = _find_scan_end(content + EOI, position)
    if position != len(content):
        raise FileError("An increment of a texture is damaged; export the package again, or copy it again.")


def join_scans(header: bytes, parts: Sequence[bytes | memoryview]) -> bytes:
    """Return the JPEG file of a header and increments or scans."""
    return b"".join([header, *parts, EOI])


def decode_tile(header: bytes, parts: Sequence[bytes | memoryview]) -> np.ndarray:
    """Return the pixels (S, S, 3) uint8 of a tile, row 0 at the bottom, from its header and the first of its increments, at least one.

    Raises:
        FileError: the data are damaged.
    """
    try:
        return decode(join_scans(header, parts))
    except ImageError as error:
        raise FileError("A tile of a texture is damaged; export the package again, or copy it again.") from error


def _read_marker(content: bytes, position: int) -> tuple[int, int]:
    """Return the marker at `position` and where its segment ends."""
    if position + 4 > len(content) or content[position] != 0xFF:
        raise FileError("A tile of a texture is damaged or truncated; export the package again, or copy it again.")
    end = position + 2 + int.from_bytes(content[position + 2 : position + 4], "big")
    if end > len(content) or end < position + 4:
        raise FileError("A tile of a texture is damaged or truncated; export the package again, or copy it again.")
    return content[position + 1], end


def _find_scan_end(content: bytes, position: int) -> int:
    """Return where the scan ends that begins at `position`, perhaps with tables."""
    marker, position = _read_marker(content, position)
    while marker != SOS:
        if marker != DHT:
            raise FileError("A tile of a texture is damaged: a scan begins with something else; export the package again.")
        marker, position = _read_marker(content, position)
    while True:
        position = content.find(b"\xff", position)
        if position < 0 or position + 1 >= len(content):
            raise FileError("A tile of a texture is truncated; export the package again, or copy it again.")
        following = content[position + 1]
        if following and following not in STANDALONE:
            return position
        position += 2
