"""Vertices of .obj and .ply files whose coordinates are too large for the single precision of Blender's importers: read with all their
digits, and written near the origin."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np

from ..errors import FileError
from ..geometry.local_origin import find_local_origin
from .file_access import check_readable, convert_os_errors, has_companion
from .ply_headers import ASCII, PlyHeader, read_ply_header
from .temporary_folders import temporary_folder

EXTENSIONS = (".obj", ".ply")
FIRST_VERTICES = 1000  # Nearly all files are known to be near the origin by these.
OBJ_VERTEX = re.compile(rb"\s*v\s")
MATERIAL_LIBRARY = re.compile(rb"mtllib\s+(.*\S)")
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


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
    with convert_os_errors(f'Cannot read "{path}"'), np.errstate(all="ignore"):
        try:
            return None if find_local_origin(read(path, FIRST_VERTICES)) is None else find_local_origin(read(path, None))
        except (ValueError, IndexError, KeyError, OverflowError, FileError):  # Blender's importer tells what is wrong
            return None


def write_moved(path: Path, out: Path, origin: np.ndarray) -> None:
    """Write a copy of a file, for which `find_file_origin` returned `origin` (3,), whose vertices are relative to it, and copies of the
    .mtl files that it names. Raises FileError."""
    with convert_os_errors(f'Cannot write "{out}"'), path.open("rb") as file, out.open("wb") as result:
        if path.suffix.lower() == ".obj":
            for line in file:
                result.write(_move_line(line, 1, origin) if OBJ_VERTEX.match(line) else line)
                if (name := parse_material_library(line)) is not None:
                    _copy_materials(path, name, out.parent)
            return
        header = read_ply_header(path)
        dtype, count = _describe_vertices(header)
        result.write(file.read(header.size))
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


def parse_material_library(line: bytes) -> str | None:
    """Return the name of the file with materials in a line of an .obj file, None in other lines."""
    found = MATERIAL_LIBRARY.match(line)
    return None if found is None else found[1].decode(errors="replace")


def _copy_materials(path: Path, name: str, folder: Path) -> None:
    """Copy the file with materials `name` of the mesh file `path` into `folder`, if it lies next to the mesh. Names of images become
    absolute paths."""
    if Path(name).name != name or not path.with_name(name).is_file():
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


def _read_obj_vertices(path: Path, count: int | None) -> np.ndarray:
    """Return the positions (N, 3) of the first `count` vertices, or all."""
    with path.open("rb") as file:
        return _to_positions(line.split()[1:4] for line in islice((line for line in file if OBJ_VERTEX.match(line)), count))


def _read_ply_vertices(path: Path, count: int | None) -> np.ndarray:
    header = read_ply_header(path)
    dtype, total = _describe_vertices(header)
    count = total if count is None else min(count, total)
    with path.open("rb") as file:
        file.seek(header.size)
        if dtype is None:
            return _to_positions(line.split()[:3] for line in islice(file, count))
        values = np.frombuffer(file.read(count * dtype.itemsize), dtype)
    return np.stack([values[axis] for axis in "xyz"], axis=1)


def _to_positions(rows: Iterator[list[bytes]]) -> np.ndarray:
    return np.array([[float(value) for value in row] for row in rows], np.float64).reshape(-1, 3)


def _describe_vertices(header: PlyHeader) -> tuple[np.dtype | None, int]:
    """Return the layout of a vertex, None in a file of text, and the number of vertices. Raises ValueError unless vertices come first,
    begin with x, y and z, and have more digits than single precision."""
    vertices = header.elements[0]
    if vertices.name != "vertex" or vertices.has_lists or [name for name, _ in vertices.properties[:3]] != ["x", "y", "z"]:
        raise ValueError("another layout")
    if header.file_format == ASCII:
        return None, vertices.count
    if any(kind != "f8" for _, kind in vertices.properties[:3]):
        raise ValueError("no more digits")
    return np.dtype([(name, BYTE_ORDERS[header.file_format] + kind) for name, kind in vertices.properties]), vertices.count
