"""Simplified meshes of objects within seconds, by Decimate."""

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.distance.deviation import measure_pixel_size, measure_texture_shift, transfer_normals
from ...core.jobs.progress import Progress, Steps
from ..blender import remove_unused_data
from ..geometry.evaluated_mesh import EvaluatedMesh
from ..geometry.mesh_arrays import read_values
from ..geometry.mesh_writing import write_evaluated_mesh
from ..geometry.meshes import find_material, read_mesh
from ..imaging.images import find_images
from ..lod_sets import KIND
from .chains import CHAIN

# Of the triangles of a decimated mesh to those of the one before, of heavy and of light ones.
RATIO, LIGHT_RATIO = 0.25, 0.5
LIGHT_TRIANGLES = 20_000  # Of light ones.
MIN_TRIANGLES = 50  # Of levels; fewer save nothing.
MAX_UV_STEP = 1e-4  # Between corners of a vertex that is at no seam.
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
    in its units.

    With a texture there are also meshes that keep its seams. They need more triangles where seams are many, but textures do not tear.
    """
    yield Progress(0.0, "Simplifying")
    found = decimate(evaluated, scene, side, min_triangles)
    if has_texture(evaluated):
        yield Progress(0.5, "Simplifying between seams")
        found = sorted([*found, *decimate(evaluated, scene, side, min_triangles, keeps_seams=True)], key=lambda level: level[1])
    return [create_level(item, mesh, size) for mesh, size in found]


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
    evaluated: EvaluatedMesh, scene: bpy.types.Scene, side: float, min_triangles: int = MIN_TRIANGLES, keeps_seams: bool = False
) -> list[tuple[EvaluatedMesh, float]]:
    """Return meshes with fewer and fewer triangles, with their pixel sizes; with `keeps_seams` nothing if there are no seams."""
    item = bpy.data.objects.new("Farfield Decimated", _create_mesh(evaluated))
    meshes = [item.data]
    scene.collection.objects.link(item)
    try:
        modifier = item.modifiers.new("Decimate", "DECIMATE")
        if keeps_seams and not _keep_seams(item, modifier, evaluated.uv_map):
            return []
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
            found.append((_with_normals(evaluated, coarse), size))
            count = len(coarse.triangles)
            if count <= LIGHT_TRIANGLES < len(evaluated.triangles) and len(meshes) == 1:  # The next ones are made of this in less time.
                item.data, modifier.ratio = _create_mesh(coarse), 1.0
                meshes.append(item.data)
                if keeps_seams:
                    _keep_seams(item, modifier, evaluated.uv_map)
        return found
    finally:
        bpy.data.batch_remove([item, *meshes])


def _create_mesh(evaluated: EvaluatedMesh) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new("Farfield Decimated")
    write_evaluated_mesh(mesh, evaluated)
    return mesh


def _keep_seams(item: bpy.types.Object, modifier: bpy.types.Modifier, uv_map: str) -> bool:
    """Let Decimate collapse edges at seams of a UV map last. Returns whether there are any."""
    mesh = item.data
    vertices, uvs = read_values(mesh.loops, "vertex_index", dtype=np.int32), read_values(mesh.uv_layers[uv_map].uv, "vector", 2)
    low, high = np.full((len(mesh.vertices), 2), np.inf), np.full((len(mesh.vertices), 2), -np.inf)
    np.minimum.at(low, vertices, uvs)
    np.maximum.at(high, vertices, uvs)
    at_seam = (high - low).max(axis=1) > MAX_UV_STEP
    group = item.vertex_groups.new(name="Collapsed")
    group.add(np.flatnonzero(~at_seam).tolist(), 1.0, "REPLACE")
    modifier.vertex_group, modifier.vertex_group_factor = group.name, 1.0
    return bool(at_seam.any())


def _with_normals(evaluated: EvaluatedMesh, coarse: EvaluatedMesh) -> EvaluatedMesh:
    """Return a decimated mesh with the shading normals of the original."""
    meshes = [(mesh.vertices[mesh.triangles], mesh.normals[mesh.loops]) for mesh in (evaluated, coarse)]
    normals = coarse.normals.copy()
    normals[coarse.loops] = transfer_normals(*meshes[0], *meshes[1])
    return replace(coarse, normals=normals)


def _measure_texture_shift(evaluated: EvaluatedMesh, coarse: EvaluatedMesh) -> float:
    """Return the length by which the texture moves on a coarse mesh, 0 without a texture."""
    name = evaluated.uv_map
    if name not in coarse.attributes or not has_texture(evaluated):
        return 0.0
    meshes = [
        (mesh.vertices[mesh.triangles], mesh.at_corners(name, np.arange(len(mesh.triangles)))[..., :2]) for mesh in (evaluated, coarse)
    ]
    return measure_texture_shift(*meshes[0], *meshes[1])
