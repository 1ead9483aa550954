"""Meshes that are filled from arrays and shown later, and a bounded pool of spare meshes that are filled again.

A pool is a word. Its spare meshes are those without users whose custom property SPARE_KEY is that word, so that undo, and files that are
opened, cannot make it wrong.
"""

from collections.abc import Hashable
from uuid import uuid4

import bpy
import numpy as np

from ...core.errors import GeometryError
from .mesh_arrays import write_attribute, write_corner_normals, write_triangles

SPARE_KEY = "farfield_spare_mesh"  # custom property of meshes that are not shown
PENDING_KEY = "farfield_pending_mesh"  # custom property of meshes that are filled: who has filled them
MAX_SPARE = 64  # meshes per pool by default
MAX_REMOVED = 64  # spare meshes that are removed at the start of a change, about 2 ms


class PendingMeshes:
    """Meshes without users that are filled now and shown later. `names` has the mesh names by key.

    Spare meshes are filled first. Meshes that are never shown become spare.
    """

    def __init__(self, pool: str, mesh_name: str, max_spare: int = MAX_SPARE) -> None:
        """mesh_name: name of new meshes. max_spare: spare meshes that are kept."""
        self.names: dict[Hashable, str] = {}
        self._pool, self._mesh_name, self._identity = pool, mesh_name, uuid4().hex
        spare = spare_meshes(pool)
        if len(spare) > max_spare:
            bpy.data.batch_remove(spare[max_spare:][:MAX_REMOVED])
        self._spare = [mesh.name for mesh in spare[:max_spare]]

    def take(self, key: Hashable) -> bpy.types.Mesh:
        """Return a mesh with any content that is to be filled for `key`. Its material slots are those of its last use."""
        mesh = self._pop_spare() or bpy.data.meshes.new(self._mesh_name)
        mesh[SPARE_KEY], mesh[PENDING_KEY] = self._pool, self._identity
        self.names[key] = mesh.name
        return mesh

    def _pop_spare(self) -> bpy.types.Mesh | None:
        """Return a spare mesh that nobody has used, filled here or replaced by another of its name since the start; None without one."""
        while self._spare:
            mesh = bpy.data.meshes.get((self._spare.pop(), None))
            if mesh and not mesh.users and mesh.get(SPARE_KEY) == self._pool and mesh.get(PENDING_KEY) != self._identity:
                return mesh
        return None

    def fill(self, key: Hashable, vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray | None = None) -> None:
        """Fill the mesh of `key`; see `fill_mesh`."""
        fill_mesh(self.take(key), vertices, triangles, normals)

    def check(self) -> None:
        """Check that nobody has changed the filled meshes.

        Raises:
            GeometryError: one of them was removed, is used, or has the content of another time, as after undo.
        """
        meshes = [bpy.data.meshes.get((name, None)) for name in self.names.values()]
        is_unchanged = all(mesh and not mesh.users and mesh.get(PENDING_KEY) == self._identity for mesh in meshes)
        if not is_unchanged or len(set(meshes)) < len(meshes):  # A new mesh may have got the name of a removed one.
            raise GeometryError("Undo has removed meshes of this command before they were shown. Run it again.")

    def claim(self, key: Hashable) -> bpy.types.Mesh:
        """Return the mesh of `key`, which is no longer spare, to be shown. See `check`."""
        mesh = bpy.data.meshes[self.names[key], None]
        del mesh[SPARE_KEY], mesh[PENDING_KEY]
        return mesh


def fill_mesh(
    mesh: bpy.types.Mesh,
    vertices: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray | None = None,
    uvs: np.ndarray | None = None,
    material_indices: np.ndarray | None = None,
) -> None:
    """Replace the geometry of a mesh and its attributes; material slots stay.

    Args:
        vertices: (V, 3), object space.
        triangles: (T, 3) int.
        normals: (V, 3) by vertex or (T, 3, 3) by corner, object space; None for flat shading.
        uvs: (T, 3, 2), the UV map "UVMap"; None for none.
        material_indices: (T,) int; None for the first material.
    """
    write_triangles(mesh, vertices, triangles)
    if not len(triangles):
        return
    if normals is None:
        _write_faces(mesh, "sharp_face", "BOOLEAN", np.ones(len(triangles), bool))  # shade_flat() takes 100 times as long
    elif normals.ndim == 2:
        write_attribute(mesh, "custom_normal", "POINT", normals)
    else:
        write_corner_normals(mesh, normals)
    if uvs is not None:
        write_attribute(mesh, "UVMap", "CORNER", uvs)
    if material_indices is not None:
        _write_faces(mesh, "material_index", "INT", np.ascontiguousarray(material_indices, np.int32))


def _write_faces(mesh: bpy.types.Mesh, name: str, data_type: str, values: np.ndarray) -> None:
    """Create an attribute with one value per face; `values` (T,) has the type that Blender stores."""
    mesh.attributes.new(name, data_type, "FACE").data.foreach_set("value", values)


def mark_spare(mesh: bpy.types.Mesh, pool: str) -> None:
    """Let the next change fill a mesh that is no longer shown. Linked meshes stay as they are."""
    if is_local(mesh):
        mesh[SPARE_KEY] = pool


def spare_meshes(pool: str) -> list[bpy.types.Mesh]:
    """Return the spare meshes of a pool."""
    return [mesh for mesh in bpy.data.meshes if mesh.users == 0 and mesh.get(SPARE_KEY) == pool and is_local(mesh)]


def is_local(data_block: bpy.types.ID) -> bool:
    """Return whether a data-block belongs to this file. Changes to others crash Blender, or are lost when the file is opened again."""
    return data_block.is_editable and data_block.override_library is None
