"""Export of terrain meshes to .ply and .obj."""

from pathlib import Path

import numpy as np

from .engine import WeldedMesh

MAX_CHUNK_LINES = 1 << 16  # lines of text that are formatted at once


def write_ply(path: Path, mesh: WeldedMesh) -> None:
    """Write a binary .ply with coordinates in double precision, because single precision would cause gaps far from the origin."""
    vertices = np.empty(len(mesh.vertices), [(name, "<f8") for name in "xyz"] + [(f"n{name}", "<f4") for name in "xyz"])
    for axis, name in enumerate("xyz"):
        vertices[name], vertices[f"n{name}"] = mesh.vertices[:, axis], mesh.normals[:, axis]
    faces = np.empty(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.triangles
    properties = [f"property double {name}" for name in "xyz"] + [f"property float n{name}" for name in "xyz"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *properties]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    with path.open("wb") as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def write_obj(path: Path, mesh: WeldedMesh, origin: np.ndarray) -> None:
    """Write an .obj with Z up. Coordinates are relative to `origin` (3,), because programs read them in single precision."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"# origin {' '.join(repr(coordinate) for coordinate in origin.tolist())}\n")
        for keyword, rows in (("v", mesh.vertices - origin), ("vn", mesh.normals)):
            for start in range(0, len(rows), MAX_CHUNK_LINES):
                file.writelines(f"{keyword} {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in rows[start : start + MAX_CHUNK_LINES].tolist())
        for start in range(0, len(mesh.triangles), MAX_CHUNK_LINES):
            rows = (mesh.triangles[start : start + MAX_CHUNK_LINES] + 1).tolist()
            file.writelines(f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in rows)
