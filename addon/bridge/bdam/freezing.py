"""Large terrain as ordinary objects: the tiles in a scene as arrays, and objects and materials that do not need Farfield."""

from collections.abc import Callable, Sequence

import bpy
import mathutils
import numpy as np

from ...core.bdam.view.freezing import FrozenMesh
from ..geometry.mesh_arrays import read_attribute, read_loop_vertices, read_positions, read_uvs
from ..geometry.mesh_pool import fill_mesh
from ..terrain_roots import copy_material, link_collection, soften_terminator
from .materials import LEVEL_ATTRIBUTE
from .objects import SceneTerrain

FROZEN_NAME = "Frozen Terrain"
PROPERTY_PREFIX = "farfield_"  # start of the names of Farfield's custom properties


def read_tiles(terrain: SceneTerrain) -> list[FrozenMesh]:
    """Return the tiles that a scene shows; the keys of their materials are names of materials."""
    meshes, origin = [], terrain.origin
    for tile in terrain.tiles().values():
        mesh = tile.data
        if not mesh.polygons:
            continue
        material = mesh.materials[0] if mesh.materials else None
        normals, levels = mesh.attributes.get("custom_normal"), mesh.attributes.get(LEVEL_ATTRIBUTE)
        meshes.append(
            FrozenMesh(
                np.array(tile.location, np.float64) + origin,
                read_positions(mesh),
                read_attribute(normals) if normals is not None else np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(mesh.vertices), 1)),
                read_loop_vertices(mesh).reshape(-1, 3),
                read_uvs(mesh.uv_layers[0]).reshape(-1, 3, 2) if mesh.uv_layers else None,
                (read_attribute(levels) if levels is not None else np.zeros(len(mesh.polygons))).astype(np.int8),
                (None if material is None else material.name,),
                np.zeros(len(mesh.polygons), np.int32),
            )
        )
    return meshes


def add_frozen_meshes(
    scene: bpy.types.Scene,
    terrain: SceneTerrain,
    meshes: Sequence[FrozenMesh],
    find_material: Callable[[int | str | None], bpy.types.Material | None],
) -> tuple[str, ...]:
    """Create objects at the position of a terrain, in a new collection. Returns their names.

    find_material: returns the material of the terrain for a key in `FrozenMesh.materials`; the objects have copies.
    """
    collection = link_collection(scene, FROZEN_NAME)
    copies: dict[int | str | None, bpy.types.Material | None] = {}
    names = []
    for source in meshes:
        mesh = bpy.data.meshes.new(FROZEN_NAME)
        fill_mesh(mesh, source.vertices, source.triangles, source.normals, source.uvs, source.slots if len(source.materials) > 1 else None)
        mesh.attributes.new(LEVEL_ATTRIBUTE, "INT", "FACE").data.foreach_set("value", source.levels.astype(np.int32))
        for key in source.materials:
            if key not in copies:
                copies[key] = _copy_material(find_material(key), terrain.root)
            mesh.materials.append(copies[key])
        item = bpy.data.objects.new(FROZEN_NAME, mesh)
        soften_terminator(item)
        item.matrix_world = terrain.root.matrix_world @ mathutils.Matrix.Translation((source.location - terrain.origin).tolist())
        collection.objects.link(item)
        names.append(item.name)
    return tuple(names)


def _copy_material(material: bpy.types.Material | None, root: bpy.types.Object) -> bpy.types.Material | None:
    """Return a copy of a material that belongs to no terrain. Heights are those of the objects, whose origins are at height 0."""
    copy = copy_material(material, root)
    for key in [key for key in copy.keys() if key.startswith(PROPERTY_PREFIX)] if copy is not None else ():  # noqa: SIM118 no dictionary
        del copy[key]
    return copy
