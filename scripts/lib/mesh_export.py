"""Triangle meshes as .ply and .obj files."""

from pathlib import Path

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


def write_obj(path: Path, vertices: np.ndarray, normals: np.ndarray, triangles: np.ndarray, origin: np.ndarray) -> None:
    """Write an .obj with Z up. Coordinates are relative to `origin` (3,), because programs read them in single precision.

    vertices: (V, 3) float64. normals: (V, 3). triangles: (T, 3) int32.
    """
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"# origin {' '.join(repr(coordinate) for coordinate in origin.tolist())}\n")
        for keyword, rows in (("v", vertices - origin), ("vn", normals)):
            for start in range(0, len(rows), MAX_CHUNK_LINES):
                file.writelines(f"{keyword} {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in rows[start : start + MAX_CHUNK_LINES].tolist())
        for start in range(0, len(triangles), MAX_CHUNK_LINES):
            rows = (triangles[start : start + MAX_CHUNK_LINES] + 1).tolist()
            file.writelines(f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in rows)
