"""Writes meshes that were read as arrays to Blender meshes."""

import bpy
import numpy as np

from ...core.geometry.mesh import longest_side
from ..shading.scene_space_nodes import required_attributes
from .evaluated_mesh import EvaluatedMesh
from .mesh_arrays import MAX_NORMAL_STEP, read_values, write_attribute, write_corner_normals, write_triangles
from .meshes import find_material

MERGE_DISTANCE = 1e-6  # Relative to the longest side. Decimate would tear open the seams of imported meshes.


def write_evaluated_mesh(mesh: bpy.types.Mesh, evaluated: EvaluatedMesh) -> None:
    """Fill a Blender mesh with one that was read, with everything that its materials may read and with merged vertices."""
    triangles, kept = _merge_vertices(evaluated)
    used, triangles = np.unique(triangles, return_inverse=True)
    write_triangles(mesh, evaluated.vertices[used], triangles.reshape(-1, 3))
    mesh.polygons.foreach_set("material_index", evaluated.material_indices[kept])
    materials = [None if key is None else find_material(key) for key in evaluated.materials]
    for material in materials:
        mesh.materials.append(material)
    required = {evaluated.uv_map, evaluated.color}
    for material in materials:
        if material is not None and material.node_tree is not None:
            required |= required_attributes(material.node_tree)
    _write_normals(mesh, evaluated.normals[evaluated.loops[kept]])
    for name in evaluated.attributes:
        if name in required:
            write_attribute(mesh, name, "CORNER", evaluated.at_corners(name, kept))
    if evaluated.uv_map:
        mesh.uv_layers[evaluated.uv_map].active_render = True
    if evaluated.color:
        mesh.attributes.default_color_name = evaluated.color


def _write_normals(mesh: bpy.types.Mesh, normals: np.ndarray) -> None:
    """Write the shading normals (T, 3, 3), and mark flat triangles, which are flat after decimation, too."""
    write_corner_normals(mesh, normals)
    face_normals = read_values(mesh.polygons, "normal", 3)
    is_flat = np.abs(normals - face_normals[:, None]).max(axis=(1, 2)) <= MAX_NORMAL_STEP
    if is_flat.any():
        mesh.attributes.new("sharp_face", "BOOLEAN", "FACE").data.foreach_set("value", is_flat)


def _merge_vertices(mesh: EvaluatedMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles (K, 3) of a mesh whose vertices at one position are one, and their indices (K,) in it.

    Vertices of coincident triangles, such as the fronts and backs of leaf cards, stay apart.
    """
    distance = max(MERGE_DISTANCE * longest_side(mesh.vertices), 1e-30)
    _, first, groups = np.unique(np.rint(mesh.vertices / distance), axis=0, return_index=True, return_inverse=True)
    groups = groups.reshape(-1)
    corners = groups[mesh.triangles]
    _, rows, counts = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True, return_counts=True)
    merged = first[corners]
    is_coincident = np.zeros(len(mesh.vertices), bool)
    is_coincident[mesh.triangles[counts[rows.reshape(-1)] > 1]] = True
    triangles = np.where(is_coincident[mesh.triangles], mesh.triangles, merged)
    kept = np.flatnonzero((triangles != np.roll(triangles, 1, axis=1)).all(axis=1))
    return triangles[kept], kept
