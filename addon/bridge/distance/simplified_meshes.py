"""Simplified meshes of objects within seconds, by Decimate."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.distance.deviation import measure_pixel_size, measure_texture_shift
from ...core.jobs.progress import Progress, Steps
from ..blender import remove_unused_data
from ..geometry.evaluated_mesh import EvaluatedMesh
from ..geometry.mesh_writing import write_evaluated_mesh
from ..geometry.meshes import find_material, read_mesh
from ..imaging.images import find_images
from ..lod_sets import KIND
from .chains import CHAIN

# Of the triangles of a decimated mesh to those of the one before, of heavy and of light ones.
RATIO, LIGHT_RATIO = 0.25, 0.5
LIGHT_TRIANGLES = 20_000  # Of light ones.
MIN_TRIANGLES = 50  # Of levels; fewer save nothing.
MAX_PIXEL = 0.125  # Of levels, relative to the longest side: the object is a few pixels large.


@dataclass(frozen=True)
class SimplifiedMesh:
    """A level of an object.

    Attributes:
        mesh: in the space of the object.
        triangles: their number.
        pixel_size: above which it looks like the original, a length in that space.
        transparent: number of triangles that opacity maps cut out, where it matters.
    """

    mesh: bpy.types.Mesh
    triangles: int
    pixel_size: float
    transparent: int = 0


def has_texture(evaluated: EvaluatedMesh) -> bool:
    """Return whether a mesh has a UV map and materials with images."""
    materials = [find_material(key) for key in evaluated.materials if key is not None]
    return bool(evaluated.uv_map and find_images([material for material in materials if material is not None]))


def simplify_solid(
    item: bpy.types.Object, evaluated: EvaluatedMesh, scene: bpy.types.Scene, side: float, min_triangles: int = MIN_TRIANGLES
) -> Steps[list[SimplifiedMesh]]:
    """Return decimated meshes of an object, finest first. `scene` is a temporary one. side: the longest one of what the object is part of,
    in its units."""
    yield Progress(0.0, "Simplifying")
    return [create_level(item, mesh, size) for mesh, size in decimate(evaluated, scene, side, min_triangles)]


def discard_unused() -> None:
    """Remove the simplified meshes, and then the opaque materials, that nothing uses."""
    meshes, materials = ([block for block in blocks if block.get(KIND) == CHAIN] for blocks in (bpy.data.meshes, bpy.data.materials))
    remove_unused_data(meshes, materials)


def create_level(item: bpy.types.Object, evaluated: EvaluatedMesh, pixel_size: float, transparent: int = 0) -> SimplifiedMesh:
    """Create the mesh of a level of `item`, with the same Generated coordinates."""
    mesh = bpy.data.meshes.new(item.name)
    mesh[KIND] = CHAIN
    write_evaluated_mesh(mesh, evaluated)
    if isinstance(item.data, bpy.types.Mesh):
        mesh.use_auto_texspace = False
        mesh.texspace_location, mesh.texspace_size = item.data.texspace_location, item.data.texspace_size
    return SimplifiedMesh(mesh, len(evaluated.triangles), pixel_size, transparent)


def decimate(
    evaluated: EvaluatedMesh, scene: bpy.types.Scene, side: float, min_triangles: int = MIN_TRIANGLES
) -> list[tuple[EvaluatedMesh, float]]:
    """Return meshes with fewer and fewer triangles, with their pixel sizes."""
    item = bpy.data.objects.new("Farfield Decimated", _create_mesh(evaluated))
    meshes = [item.data]
    scene.collection.objects.link(item)
    try:
        modifier = item.modifiers.new("Decimate", "DECIMATE")
        modifier.use_collapse_triangulate = True
        found: list[tuple[EvaluatedMesh, float]] = []
        count = len(evaluated.triangles)
        vertices = evaluated.vertices[evaluated.triangles].reshape(-1, 3)

        while (ratio := LIGHT_RATIO if count <= LIGHT_TRIANGLES else RATIO) * count > min_triangles:
            modifier.ratio *= ratio
            scene.view_layers[0].update()
            depsgraph = scene.view_layers[0].depsgraph
            coarse = read_mesh(item.evaluated_get(depsgraph), depsgraph)
            if not 0 < len(coarse.triangles) < 0.75 * count:
                break
            size = max(measure_pixel_size(vertices, coarse.vertices[coarse.triangles]), _measure_texture_shift(evaluated, coarse))
            if size > MAX_PIXEL * side:
                break
            found.append((coarse, size))
            count = len(coarse.triangles)
            if count <= LIGHT_TRIANGLES < len(evaluated.triangles) and len(meshes) == 1:  # The next ones are made of this in less time.
                item.data, modifier.ratio = _create_mesh(coarse), 1.0
                meshes.append(item.data)
        return found
    finally:
        bpy.data.batch_remove([item, *meshes])


def _create_mesh(evaluated: EvaluatedMesh) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new("Farfield Decimated")
    write_evaluated_mesh(mesh, evaluated)
    return mesh


def _measure_texture_shift(evaluated: EvaluatedMesh, coarse: EvaluatedMesh) -> float:
    """Return the length by which the texture moves on a coarse mesh, 0 without a texture."""
    name = evaluated.uv_map
    if name not in coarse.attributes or not has_texture(evaluated):
        return 0.0
    meshes = [
        (mesh.vertices[mesh.triangles], mesh.at_corners(name, np.arange(len(mesh.triangles)))[..., :2]) for mesh in (evaluated, coarse)
    ]
    return measure_texture_shift(*meshes[0], *meshes[1])
