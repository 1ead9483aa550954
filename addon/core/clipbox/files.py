"""Terrain as files for other programs."""

from pathlib import Path

import numpy as np

from .terrain import Welded

CHUNK = 1 << 16  # lines of text that are put together at once


def write_ply(path: Path, surface: Welded) -> None:
    """Write a binary .ply with coordinates in double precision: far from the origin single precision would tear the surface apart."""
    vertices = np.empty(len(surface.vertices), [(name, "<f8") for name in "xyz"] + [(f"n{name}", "<f4") for name in "xyz"])
    for axis, name in enumerate("xyz"):
        vertices[name], vertices[f"n{name}"] = surface.vertices[:, axis], surface.normals[:, axis]
    faces = np.empty(len(surface.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, surface.triangles
    properties = [f"property double {name}" for name in "xyz"] + [f"property float n{name}" for name in "xyz"]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *properties]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    with path.open("wb") as file:
        file.write("\n".join(head).encode("ascii"))
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def write_obj(path: Path, surface: Welded, origin: np.ndarray) -> None:
    """Write an .obj, Z up as in the terrain, with coordinates from the place `origin` (3,) on: who reads it has single precision."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"# origin {' '.join(repr(each) for each in origin.tolist())}\n")
        for word, rows in (("v", surface.vertices - origin), ("vn", surface.normals)):
            for start in range(0, len(rows), CHUNK):
                file.writelines(f"{word} {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in rows[start : start + CHUNK].tolist())
        for start in range(0, len(surface.triangles), CHUNK):
            rows = (surface.triangles[start : start + CHUNK] + 1).tolist()
            file.writelines(f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in rows)
