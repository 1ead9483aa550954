"""Headers of .ply files, checked before Blender reads them: its reader ends the program if a number of elements is impossible."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import FileError
from .file_access import check_readable, convert_os_errors

MAX_HEADER_BYTES = 1 << 20
MAX_COUNT = (1 << 31) - 1  # Blender counts elements in 32 bits
TYPES = {  # NumPy types by those of the format
    **dict.fromkeys(("char", "int8"), "i1"), **dict.fromkeys(("uchar", "uint8"), "u1"), **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"), **dict.fromkeys(("int", "int32"), "i4"), **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"), **dict.fromkeys(("double", "float64"), "f8"),
}  # fmt: skip
KEYWORDS = ("format", "element", "property")
COUNT = re.compile("[0-9]{1,10}")
HEADER_END = re.compile(rb"\bend_header[ \t]*(?:\r\n?|\n|$)")
ASCII, ASCII_VALUE_BYTES = "ascii", 2  # a digit and a separator


@dataclass
class PlyElement:
    """A kind of elements. properties: names and types of NumPy; of a list, the type of its length. has_lists: whether there are lists."""

    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)
    has_lists: bool = False


@dataclass(frozen=True)
class PlyHeader:
    """A header. size: bytes in front of the first element. file_format: "ascii", "binary_little_endian" or "binary_big_endian"."""

    size: int
    file_format: str
    elements: list[PlyElement]


def read_ply_header(path: Path) -> PlyHeader:
    """Read the header of a .ply file.

    Raises:
        FileError: it cannot be read, is broken, or declares more elements than fit into the file.
    """
    check_readable(path)
    with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as file:
        start, file_size = file.read(MAX_HEADER_BYTES), path.stat().st_size
    end = HEADER_END.search(start)
    lines = start[: end.start()].decode("ascii", errors="replace").splitlines() if end else []
    if not lines or lines[0].strip() != "ply":
        raise FileError(f'"{path}" cannot be read: it has no PLY header; export it again.')
    header = PlyHeader(end.end(), *_parse(path, lines[1:]))
    content_size = file_size - header.size
    for element in header.elements:
        sizes = [ASCII_VALUE_BYTES if header.file_format == ASCII else int(kind[1]) for _, kind in element.properties]
        content_size -= element.count * max(sum(sizes), 1)
    if content_size < (-1 if header.file_format == ASCII else 0):  # the last line of a text may lack its end
        counts = ", ".join(f"{element.count:,} x {element.name}" for element in header.elements)
        raise FileError(f'"{path}" cannot be read: its header declares {counts}, more than the file can hold; it is truncated or damaged.')
    return header


def _parse(path: Path, lines: list[str]) -> tuple[str, list[PlyElement]]:
    """Return the format, and the elements. Raises FileError."""
    file_format, elements = "", []
    for line in lines:
        keyword, *words = line.split() or [""]
        if keyword in KEYWORDS and line[0].isspace():  # Blender takes it for a comment, and its reader may end the program
            raise FileError(f'"{path}" cannot be read: a line of its header begins with a space, "{line.strip():.80}"; export it again.')
        if keyword == "format":
            file_format = "".join(words[:1])
        elif keyword == "element" and len(words) == 2 and COUNT.fullmatch(words[1]) and int(words[1]) <= MAX_COUNT:
            elements.append(PlyElement(words[0], int(words[1])))
        elif keyword == "property" and elements and len(words) > 1 and words[words[0] == "list"] in TYPES:
            elements[-1].properties.append((words[-1], TYPES[words[words[0] == "list"]]))
            elements[-1].has_lists |= words[0] == "list"
        elif keyword in ("element", "property"):
            raise FileError(f'"{path}" cannot be read: its header has the invalid line "{line.strip():.80}"; export it again.')
    return file_format, elements
