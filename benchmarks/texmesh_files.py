"""Textured meshes as .obj and .glb files, for the programs that `bench_texmesh.py` compares with."""

from pathlib import Path
from typing import Any

import numpy as np

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.files.glb import load_glb
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh

MATERIAL_PREFIX = "material_"


def write_obj(path: Path, mesh: TexturedMesh, textures: dict[int, str]) -> None:
    """Write an .obj and an .mtl next to it. textures: image files by material; pymeshlab joins materials that share one."""
    entries = [f"newmtl {MATERIAL_PREFIX}{material}\nKd 1 1 1\nmap_Kd {texture}\n" for material, texture in textures.items()]
    path.with_suffix(".mtl").write_text("".join(entries), "ascii")
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(f"mtllib {path.with_suffix('.mtl').name}\n")
        file.writelines(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.vertices.tolist())
        file.writelines(f"vt {u:.9g} {v:.9g}\n" for u, v in mesh.uvs.tolist())
        for material in np.unique(mesh.materials):
            rows = mesh.materials == material
            file.write(f"usemtl {MATERIAL_PREFIX}{material}\n")
            corners = np.stack([mesh.triangles[rows], mesh.wedge_triangles[rows]], axis=2) + 1
            file.writelines(f"f {a}/{b} {c}/{d} {e}/{f}\n" for a, b, c, d, e, f in corners.reshape(-1, 6).tolist())


def read_obj(path: Path) -> TexturedMesh:
    """Read the triangles and quadrilaterals of an .obj with texture coordinates. Materials are numbered by `usemtl`."""
    points, uvs, corners, materials = [], [], [], []
    names: dict[str, int] = {}
    material = 0
    with path.open(encoding="utf-8") as file:
        for line in file:
            words = line.split()
            if not words:
                continue
            if words[0] == "v":
                points.append([float(word) for word in words[1:4]])
            elif words[0] == "vt":
                uvs.append([float(word) for word in words[1:3]])
            elif words[0] == "usemtl":
                material = _find_material(words[1], names)
            elif words[0] == "f":
                face = [[int(number) for number in word.split("/")[:2]] for word in words[1:]]
                for index in range(1, len(face) - 1):
                    corners.append([face[0], face[index], face[index + 1]])
                    materials.append(material)
    indices = np.array(corners)
    indices = np.where(indices > 0, indices - 1, indices + np.array([len(points), len(uvs)]))
    mesh = TriangleMesh(np.array(points), indices[:, :, 0].astype(np.int32), np.array(materials, np.int32))
    return build_textured_mesh(mesh, np.array(uvs)[indices[:, :, 1]], name=path.stem)


def _find_material(name: str, names: dict[str, int]) -> int:
    number = name.removeprefix(MATERIAL_PREFIX)
    return int(number) if number.isdigit() else names.setdefault(name, len(names))


def read_glb(path: Path) -> TexturedMesh:
    """Read the triangles with texture coordinates of an uncompressed .glb; others are left out.

    Materials keep their numbers, or those of `write_obj`.
    """
    document = load_glb(path.read_bytes())
    names: dict[str, int] = {}
    numbers = [_find_material(entry.get("name", str(index)), names) for index, entry in enumerate(document.get("materials", []))]
    points, uvs, triangles, materials = [], [], [], []
    offset = 0
    for node, matrix in _list_nodes(document):
        for primitive in document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
            if "TEXCOORD_0" not in primitive["attributes"]:
                continue
            positions = primitive["attributes"]["POSITION"].astype(np.float64)
            points.append(positions @ matrix[:3, :3].T + matrix[:3, 3])
            uvs.append(primitive["attributes"]["TEXCOORD_0"] * [1.0, -1.0] + [0.0, 1.0])
            faces = primitive["indices"].reshape(-1, 3)
            triangles.append(faces + offset)
            materials.append(np.full(len(faces), numbers[primitive["material"]] if "material" in primitive else 0, np.int32))
            offset += len(positions)
    if not triangles:
        raise GeometryError(f"{path.name} has no triangles; choose another model.")
    faces = np.concatenate(triangles).astype(np.int32)
    mesh = TriangleMesh(np.concatenate(points), faces, np.concatenate(materials))
    return build_textured_mesh(mesh, np.concatenate(uvs)[faces], name=path.stem)


def _list_nodes(document: dict[str, Any]) -> list[tuple[dict[str, Any], np.ndarray]]:
    """Return the nodes of the scene with their matrices to the world."""
    found = []
    queue = [(index, np.eye(4)) for index in document["scenes"][document.get("scene", 0)].get("nodes", [])]
    while queue:
        index, parent = queue.pop()
        node = document["nodes"][index]
        matrix = parent @ _read_matrix(node)
        found.append((node, matrix))
        queue += [(child, matrix) for child in node.get("children", [])]
    return found


def _read_matrix(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0.0, 0.0, 0.0, 1.0])
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", [1.0, 1.0, 1.0]))
    matrix[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return matrix
