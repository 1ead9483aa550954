"""Folders of images as in the BTF databases of Bonn and UTIA: names of directions and images, and the detection of incomplete EXR files.

Blender does not report every failed write.
"""

import struct
from pathlib import Path

import numpy as np

from ...errors import SettingsError
from ...geometry.directions import to_spherical

MAGIC = b"\x76\x2f\x31\x01"
CHUNK_HEADER = struct.Struct("<ii")  # First line of a chunk, and its size in bytes.
DATA_WINDOW, COMPRESSION = b"dataWindow", b"compression"
LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16}  # By compression: none, RLE, ZIP of single lines, ZIP.


def direction_names(directions: np.ndarray, letter: str) -> list[str]:
    """Return one name for each of the unit `directions` (N, 3): `tv030_pv060` for 30 degrees from +Z and azimuth 60, with `letter` v.

    letter: v for views, l for lights. Degrees are rounded to integers, as readers expect.

    Raises:
        SettingsError: two directions would have the same name.
    """
    degrees = np.rint(np.degrees(to_spherical(directions))).astype(int) % [360, 360]
    names = [f"t{letter}{polar:03d}_p{letter}{azimuth:03d}" for polar, azimuth in degrees]
    if len(set(names)) < len(names):
        raise SettingsError(
            "Some directions are less than a degree apart and would get the same file name; set Directions to Bonn.", ("directions",)
        )
    return names


def format_direction_list(directions: np.ndarray) -> str:
    """Return a text with one line for each of the unit `directions` (N, 3): number from 1 on, degrees from +Z, azimuth in degrees."""
    degrees = np.degrees(to_spherical(directions))
    return "".join(f"{number} {polar:.6f} {azimuth:.6f}\n" for number, (polar, azimuth) in enumerate(degrees, 1))


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
    except (struct.error, ValueError, KeyError, IndexError):  # A part of the header or of the table is missing.
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
