"""Triangle meshes as .ply and .obj files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

MAX_CHUNK_LINES = 1 << 16  # lines of text that are formatted at once


def write_ply(path: Path, vertices: np.ndarray, normals: np.ndarray, triangles: np.ndarray) -> None:
    """Write a binary .ply with coordinates in double precision, because single precision would cause gaps far from the origin.

    vertices: (V, 3) float64. normals: (V, 3). triangles: (T, 3) int32.
    """
    points = np.empty(len(vertices), [(name, "<f8") for name in "xyz"] + [(f"n{name}", "<f4") for name in "xyz"])
    for axis, name in enumerate("xyz"):
        points[name], points[f"n{name}"] = vertices[:, axis], normals[:, axis]
    faces = np.empty(len(triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    properties = [f"property double {name}" for name in "xyz"] + [f"property float n{name}" for name in "xyz"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    with path.open("wb") as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(points.tobytes())
        file.write(faces.tobytes())


@dataclass(frozen=True, eq=False)
class ObjPart:
    """Triangles of an .obj with one material.

    Attributes:
        triangles: (T, 3) int, indices of vertices.
        uvs: (U, 2), None without.
        uv_triangles: (T, 3) int, indices of `uvs` of the same corners.
        material: name without spaces, None without.
    """

    triangles: np.ndarray
    uvs: np.ndarray | None = None
    uv_triangles: np.ndarray | None = None
    material: str | None = None


def write_obj(
    path: Path, vertices: np.ndarray, normals: np.ndarray, parts: Sequence[ObjPart], origin: np.ndarray, library: str | None = None
) -> None:
    """Write an .obj with Z up. Coordinates are relative to `origin` (3,), because programs read them in single precision.

    vertices: (V, 3) float64. normals: (V, 3). library: name of the file of the materials.
    """
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# origin {' '.join(repr(coordinate) for coordinate in origin.tolist())}\n")
        if library is not None:
            file.write(f"mtllib {library}\n")
        for keyword, rows in (("v", vertices - origin), ("vn", normals)):
            for start in range(0, len(rows), MAX_CHUNK_LINES):
                file.writelines(f"{keyword} {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in rows[start : start + MAX_CHUNK_LINES].tolist())
        first_uv = 1
        for part in parts:
            first_uv += _write_part(file, part, first_uv)


def _write_part(file: TextIO, part: ObjPart, first_uv: int) -> int:
    """Write the triangles of a part whose UV coordinates are numbered from `first_uv` on. Returns the number of these."""
    if part.material is not None:
        file.write(f"usemtl {part.material}\n")
    uvs = np.zeros((0, 2)) if part.uvs is None else part.uvs
    for start in range(0, len(uvs), MAX_CHUNK_LINES):
        file.writelines(f"vt {u:.9g} {v:.9g}\n" for u, v in uvs[start : start + MAX_CHUNK_LINES].tolist())
    for start in range(0, len(part.triangles), MAX_CHUNK_LINES):
        rows = (part.triangles[start : start + MAX_CHUNK_LINES] + 1).tolist()
        if part.uvs is None:
            file.writelines(f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in rows)
            continue
        corners = (part.uv_triangles[start : start + MAX_CHUNK_LINES] + first_uv).tolist()
        file.writelines(f"f {a}/{i}/{a} {b}/{j}/{b} {c}/{k}/{c}\n" for (a, b, c), (i, j, k) in zip(rows, corners, strict=True))
    return len(uvs)
