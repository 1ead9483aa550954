"""Simplified meshes of heavy objects within seconds: by Decimate, and foliage by fewer and larger leaves, see `aggregates`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.distance.aggregates import Elements, count_triangles, find_elements, simplify_elements
from ...core.distance.deviation import measure_pixel_size, measure_texture_shift
from ...core.geometry.mesh import face_areas_and_normals, longest_side
from ...core.jobs.progress import Progress, Steps
from ..geometry.evaluated_mesh import EvaluatedMesh, MeshAttribute
from ..geometry.joined_meshes import join_instances
from ..geometry.mesh_writing import write_evaluated_mesh
from ..geometry.meshes import SourceInstance, find_material, read_mesh
from ..imaging.images import find_images
from ..lod_sets import KIND
from .chains import CHAIN

RATIO = 0.25  # Of the triangles of a decimated mesh to those of the one before.
MIN_TRIANGLES = 50  # Of levels; fewer save nothing.
MAX_PIXEL = 0.125  # Of levels, relative to the longest side: the object is a few pixels large.
# Pixels of the levels of foliage that are tried, relative to the longest side.
PIXELS = 0.5 ** np.arange(14.0, 2.9, -0.5)
FOLIAGE_RATIO = 0.3  # Of the triangles of a level of foliage to those of the one before, at most; a wood shows all levels at once.


@dataclass(frozen=True)
class SimplifiedMesh:
    """mesh: of a level, in the space of its object. triangles: their number. pixel_size: above which it looks like the original, a length
    in that space."""

    mesh: bpy.types.Mesh
    triangles: int
    pixel_size: float


def read_elements(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> tuple[EvaluatedMesh, Elements | None]:
    """Return the evaluated mesh of an object and its leaves, None if it is no foliage."""
    evaluated = read_mesh(item.evaluated_get(depsgraph), depsgraph)
    return evaluated, find_elements(evaluated.vertices, evaluated.triangles)


def has_texture(evaluated: EvaluatedMesh) -> bool:
    """Return whether a mesh has a UV map and materials with images."""
    materials = [find_material(key) for key in evaluated.materials if key is not None]
    return bool(evaluated.uv_map and find_images([material for material in materials if material is not None]))


def simplify_foliage(
    item: bpy.types.Object, evaluated: EvaluatedMesh, elements: Elements, scene: bpy.types.Scene
) -> Steps[list[SimplifiedMesh]]:
    """Return levels of an object that is foliage, finest first. `scene` is a temporary one, for Decimate."""
    yield Progress(0.0, "Simplifying branches")
    rest = np.flatnonzero(elements.of_triangles < 0)
    branches: list[tuple[EvaluatedMesh | None, float]] = [(_take(evaluated, rest) if len(rest) else None, 0.0)]
    if len(rest):
        branches += [(mesh, size) for mesh, size in _decimate(branches[0][0], scene)]
    side = longest_side(evaluated.vertices)
    levels: list[SimplifiedMesh] = []
    previous = len(evaluated.triangles)
    for step, pixel_size in enumerate((side * PIXELS).tolist()):
        branch = next(mesh for mesh, size in reversed(branches) if size <= pixel_size)
        count = count_triangles(elements, pixel_size) + (0 if branch is None else len(branch.triangles))
        if count > FOLIAGE_RATIO * previous or count < MIN_TRIANGLES:
            continue
        yield Progress(step / len(PIXELS), "Dropping leaves")
        level = simplify_elements(elements, pixel_size)
        corners = 3 * level.kept[:, None] + np.arange(3)
        positions = np.concatenate([evaluated.vertices[evaluated.triangles[level.kept]], level.positions])
        is_flat = np.concatenate([np.zeros(len(corners), bool), level.is_flat])
        leaves = _take_corners(evaluated, positions, np.concatenate([corners, level.sources]), is_flat)
        levels.append(_create(item, _join([leaves] if branch is None else [branch, leaves]), pixel_size))
        previous = count
    return levels


def simplify_solid(item: bpy.types.Object, evaluated: EvaluatedMesh, scene: bpy.types.Scene) -> Steps[list[SimplifiedMesh]]:
    """Return decimated meshes of an object, finest first. `scene` is a temporary one."""
    yield Progress(0.0, "Simplifying")
    return [_create(item, mesh, size) for mesh, size in _decimate(evaluated, scene)]


def discard_unused() -> None:
    """Remove the simplified meshes that nothing uses."""
    bpy.data.batch_remove([mesh for mesh in bpy.data.meshes if mesh.get(KIND) == CHAIN and not mesh.users])


def _create(item: bpy.types.Object, evaluated: EvaluatedMesh, pixel_size: float) -> SimplifiedMesh:
    """Create the mesh of a level of `item`, with the same Generated coordinates."""
    mesh = bpy.data.meshes.new(item.name)
    mesh[KIND] = CHAIN
    write_evaluated_mesh(mesh, evaluated)
    if isinstance(item.data, bpy.types.Mesh):
        mesh.use_auto_texspace = False
        mesh.texspace_location, mesh.texspace_size = item.data.texspace_location, item.data.texspace_size
    return SimplifiedMesh(mesh, len(evaluated.triangles), pixel_size)


def _decimate(evaluated: EvaluatedMesh, scene: bpy.types.Scene) -> list[tuple[EvaluatedMesh, float]]:
    """Return meshes with fewer and fewer triangles, with their pixel sizes."""
    mesh = bpy.data.meshes.new("Farfield Decimated")
    item = bpy.data.objects.new("Farfield Decimated", mesh)
    scene.collection.objects.link(item)
    try:
        write_evaluated_mesh(mesh, evaluated)
        modifier = item.modifiers.new("Decimate", "DECIMATE")
        modifier.use_collapse_triangulate = True
        found: list[tuple[EvaluatedMesh, float]] = []
        count, side = len(evaluated.triangles), longest_side(evaluated.vertices)
        vertices = evaluated.vertices[evaluated.triangles].reshape(-1, 3)

        while RATIO * count > MIN_TRIANGLES:
            modifier.ratio *= RATIO
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
        return found
    finally:
        bpy.data.batch_remove([item, mesh])


def _measure_texture_shift(evaluated: EvaluatedMesh, coarse: EvaluatedMesh) -> float:
    """Return the length by which the texture moves on a coarse mesh, 0 without a texture."""
    name = evaluated.uv_map
    if name not in coarse.attributes or not has_texture(evaluated):
        return 0.0
    meshes = [
        (mesh.vertices[mesh.triangles], mesh.at_corners(name, np.arange(len(mesh.triangles)))[..., :2]) for mesh in (evaluated, coarse)
    ]
    return measure_texture_shift(*meshes[0], *meshes[1])


def _take(evaluated: EvaluatedMesh, triangles: np.ndarray) -> EvaluatedMesh:
    """Return some triangles of a mesh."""
    corners = 3 * triangles[:, None] + np.arange(3)
    return _take_corners(evaluated, evaluated.vertices[evaluated.triangles[triangles]], corners, np.zeros(len(triangles), bool))


def _take_corners(evaluated: EvaluatedMesh, positions: np.ndarray, sources: np.ndarray, is_flat: np.ndarray) -> EvaluatedMesh:
    """Return triangles with corners at `positions` (N, 3, 3), and everything else from the corners `sources` (N, 3) of a mesh,
    3 * triangle + corner; those that are flat (N,) have the normals of their faces."""
    faces, corners = sources // 3, sources % 3
    indices = np.arange(sources.size, dtype=np.int32).reshape(-1, 3)
    normals = evaluated.normals[evaluated.loops[faces, corners]]
    _, face_normals = face_areas_and_normals(positions)
    normals = np.where(is_flat[:, None, None], face_normals[:, None], normals).astype(np.float32)
    attributes = {
        name: MeshAttribute("POINT" if attribute.domain == "POINT" else "CORNER", _at_corners(evaluated, attribute, faces, corners))
        for name, attribute in evaluated.attributes.items()
    }
    return replace(
        evaluated,
        vertices=positions.reshape(-1, 3).astype(np.float32),
        triangles=indices,
        loops=indices,
        polygons=np.arange(len(sources), dtype=np.int32),
        normals=normals.reshape(-1, 3),
        generated=evaluated.generated[evaluated.triangles[faces, corners]].reshape(-1, 3),
        material_indices=evaluated.material_indices[faces[:, 0]],
        attributes=attributes,
    )


def _at_corners(evaluated: EvaluatedMesh, attribute: MeshAttribute, faces: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the values (3 N, width) of an attribute at corners (N, 3) of a mesh."""
    if attribute.domain == "CORNER":
        rows = evaluated.loops[faces, corners]
    else:
        rows = evaluated.triangles[faces, corners] if attribute.domain == "POINT" else evaluated.polygons[faces]
    return attribute.values[rows.ravel()]


def _join(meshes: Sequence[EvaluatedMesh]) -> EvaluatedMesh:
    if len(meshes) == 1:
        return meshes[0]
    return join_instances([SourceInstance("", mesh, np.eye(4), 0) for mesh in meshes], np.eye(4))
