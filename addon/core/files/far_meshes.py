"""Vertices of .obj and .ply files whose coordinates are too large for the single precision of Blender's importers: read with all their
digits, and written near the origin."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..geometry.local_origin import find_local_origin
from .file_access import check_readable, convert_os_errors, has_companion
from .temporary_folders import temporary_folder

EXTENSIONS = (".obj", ".ply")
FIRST_VERTICES = 1000  # Nearly all files are known to be near the origin by these.
OBJ_VERTEX = re.compile(rb"\s*v\s")
MAX_HEADER_LINES = 1000
PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"), **dict.fromkeys(("uchar", "uint8"), "u1"), **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"), **dict.fromkeys(("int", "int32"), "i4"), **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"), **dict.fromkeys(("double", "float64"), "f8"),
}  # fmt: skip


@contextmanager
def near_origin(path: Path) -> Iterator[tuple[Path, np.ndarray | None]]:
    """Yield the path of a mesh file to import, and the position (3,) from which it was moved to the origin, None if it was not; see
    `find_file_origin`. A moved file is a temporary one. Raises FileError."""
    origin = find_file_origin(path)
    if origin is None:
        yield path, None
        return
    with temporary_folder() as folder:
        write_moved(path, folder / path.name, origin)
        yield folder / path.name, origin


def find_file_origin(path: Path) -> np.ndarray | None:
    """Return the position (3,) by which the mesh in a file should be moved to the origin before Blender reads it; None if single
    precision is exact enough, or the file has no more digits, is damaged, or is of another kind. Raises FileError if it cannot be read."""
    if path.suffix.lower() not in EXTENSIONS:
        return None
    check_readable(path)
    read = _read_obj_vertices if path.suffix.lower() == ".obj" else _read_ply_vertices
    with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as file, np.errstate(all="ignore"):
        try:
            if find_local_origin(read(file, FIRST_VERTICES)) is None:
                return None
            file.seek(0)
            return find_local_origin(read(file, None))
        except (ValueError, IndexError, KeyError, OverflowError):  # Blender's importer tells what is wrong
            return None


def write_moved(path: Path, out: Path, origin: np.ndarray) -> None:
    """Write a copy of a file, for which `find_file_origin` returned `origin` (3,), whose vertices are relative to it, and copies of the
    .mtl files that it names. Raises FileError."""
    with convert_os_errors(f'Cannot write "{out}"'), path.open("rb") as file, out.open("wb") as result:
        if path.suffix.lower() == ".obj":
            for line in file:
                result.write(_move_line(line, 1, origin) if OBJ_VERTEX.match(line) else line)
                if line.startswith(b"mtllib"):
                    _copy_materials(path, line[6:].decode(errors="replace").strip(), out.parent)
            return
        header, dtype, count = _read_ply_header(file)
        result.write(header)
        if dtype is None:
            for _ in range(count):
                result.write(_move_line(file.readline(), 0, origin))
        else:
            values = np.frombuffer(file.read(count * dtype.itemsize), dtype).copy()
            for axis, shift in zip("xyz", origin, strict=True):
                values[axis] -= shift
            result.write(values.tobytes())
        while block := file.read(1 << 20):
            result.write(block)


def _copy_materials(path: Path, name: str, folder: Path) -> None:
    """Copy the file with materials `name` of the mesh file `path` into `folder`, if it lies next to the mesh. Names of images become
    absolute paths."""
    if not name or Path(name).name != name or not path.with_name(name).is_file():
        return
    lines = []
    for line in path.with_name(name).read_text(encoding="utf-8", errors="surrogateescape").splitlines():
        words = line.split(" ")
        names = [(words[:first], path.with_name(" ".join(words[first:]))) for first in range(1, len(words)) if words[first]]
        image = next(((before, found) for before, found in names if has_companion(found)), None)
        lines.append(line if image is None else " ".join([*image[0], image[1].absolute().as_posix()]))
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8", errors="surrogateescape")


def _move_line(line: bytes, first: int, origin: np.ndarray) -> bytes:
    """Return a line of text whose values from the `first` on are a position, moved by `origin`."""
    values = line.split()
    moved = [repr(float(value) - shift).encode() for value, shift in zip(values[first : first + 3], origin.tolist(), strict=True)]
    return b" ".join([*values[:first], *moved, *values[first + 3 :]]) + b"\n"


def _read_obj_vertices(file: BinaryIO, count: int | None) -> np.ndarray:
    """Return the positions (N, 3) of the first `count` vertices, or all."""
    lines = (line for line in file if OBJ_VERTEX.match(line))
    return _to_positions(line.split()[1:4] for line, _ in zip(lines, _count_to(count), strict=False))


def _read_ply_vertices(file: BinaryIO, count: int | None) -> np.ndarray:
    _, dtype, total = _read_ply_header(file)
    count = total if count is None else min(count, total)
    if dtype is None:
        return _to_positions(file.readline().split()[:3] for _ in range(count))
    values = np.frombuffer(file.read(count * dtype.itemsize), dtype)
    return np.stack([values[axis] for axis in "xyz"], axis=1)


def _to_positions(rows: Iterator[list[bytes]]) -> np.ndarray:
    return np.array([[float(value) for value in row] for row in rows], np.float64).reshape(-1, 3)


def _count_to(count: int | None) -> Iterator[int]:
    return iter(range(count)) if count is not None else iter(int, 1)


def _read_ply_header(file: BinaryIO) -> tuple[bytes, np.dtype | None, int]:
    """Return the header, the layout of a vertex, None in a file of text, and the number of vertices. Raises ValueError unless vertices come
    first, begin with x, y and z, and have more digits than single precision."""
    lines, properties, kind, count, elements = [], [], b"", 0, 0
    for _ in range(MAX_HEADER_LINES):
        line = file.readline(MAX_HEADER_LINES)
        lines.append(line)
        words = line.split()
        if words[:1] == [b"format"]:
            kind = words[1]
        elif words[:1] == [b"element"]:
            elements += 1
            if elements == 1:
                if words[1] != b"vertex":
                    raise ValueError("no vertices")
                count = int(words[2])
        elif words[:1] == [b"property"] and elements == 1:
            properties.append((words[2].decode(), PLY_TYPES[words[1].decode()]))
        elif words[:1] == [b"end_header"]:
            break
    names = [name for name, _ in properties[:3]]
    if names != ["x", "y", "z"] or kind not in (b"ascii", b"binary_little_endian", b"binary_big_endian"):
        raise ValueError("another layout")
    if kind == b"ascii":
        return b"".join(lines), None, count
    if any(dtype != "f8" for _, dtype in properties[:3]):
        raise ValueError("no more digits")
    order = "<" if kind == b"binary_little_endian" else ">"
    return b"".join(lines), np.dtype([(name, order + dtype) for name, dtype in properties]), count
