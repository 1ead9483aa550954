"""Headers of .ply files, checked before Blender reads them: its reader ends the program if a number of elements is impossible."""

import re
from dataclasses import dataclass
from pathlib import Path

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError

MAX_HEADER_BYTES = 1 << 20
MAX_COUNT = (1 << 31) - 1  # Blender counts elements in 32 bits
TYPE_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
KEYWORDS = ("format", "element", "property")
COUNT = re.compile("[0-9]{1,10}")
ASCII_VALUE_BYTES = 2  # a digit and a separator


@dataclass
class Element:
    """A kind of elements that the header declares. sizes: the minimum bytes of each property in a binary file."""

    name: str
    count: int
    sizes: list[int]


def check_ply_header(path: Path) -> None:
    """Check that the numbers of elements in the header of a .ply file are possible for the size of the file.

    Raises:
        FileError: they are not, or the header is broken.
    """
    try:
        with path.open("rb") as file:
            start = file.read(MAX_HEADER_BYTES)
        total_size = path.stat().st_size
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error.strerror}.') from error
    header, end, _ = start.partition(b"end_header")
    lines = header.decode("ascii", errors="replace").splitlines()
    if not end or not lines or lines[0].strip() != "ply":
        raise FileError(f'"{path}" cannot be read: it has no PLY header; export it again.')
    is_ascii, elements = _parse(path, lines[1:])
    content_size = total_size - len(header) - len(end)
    for element in elements:
        element_size = ASCII_VALUE_BYTES * len(element.sizes) if is_ascii else sum(element.sizes)
        content_size -= element.count * max(element_size, 1)
    if content_size < (-1 if is_ascii else 0):  # the last line of a text may lack its end
        counts = ", ".join(f"{element.count:,} x {element.name}" for element in elements)
        raise FileError(f'"{path}" cannot be read: its header declares {counts}, more than the file can hold; it is truncated or damaged.')


def _parse(path: Path, lines: list[str]) -> tuple[bool, list[Element]]:
    """Return whether the format is ASCII, and the elements. Raises FileError."""
    is_ascii, elements = False, []
    for line in lines:
        keyword, *words = line.split() or [""]
        if keyword in KEYWORDS and line[0].isspace():  # Blender takes it for a comment, and its reader may end the program
            raise FileError(f'"{path}" cannot be read: a line of its header begins with a space, "{line.strip():.80}"; export it again.')
        if keyword == "format":
            is_ascii = words[:1] == ["ascii"]
        elif keyword == "element":
            elements.append(Element(words[0] if words else "", _parse_count(path, line, words), []))
        elif keyword == "property":
            size = TYPE_SIZES.get(words[1] if words[:1] == ["list"] and len(words) > 1 else words[0] if words else "")
            if size is None or not elements:
                raise FileError(f'"{path}" cannot be read: its header has the invalid line "{line.strip():.80}"; export it again.')
            elements[-1].sizes.append(size)
    return is_ascii, elements


def _parse_count(path: Path, line: str, words: list[str]) -> int:
    if len(words) == 2 and COUNT.fullmatch(words[1]) and int(words[1]) <= MAX_COUNT:
        return int(words[1])
    raise FileError(f'"{path}" cannot be read: its header has the invalid line "{line.strip():.80}"; export it again.')
