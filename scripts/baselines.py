"""What relightable clouds are held against: octahedral impostors of as many bytes, and decimated meshes of as many triangles.

Both are new objects in the scene's collection, beside their originals. A picture of an impostor is right from where it faces, so turn it
before each picture: `baseline.face(direction)`, then `room.picture(baseline.objects, direction, ...)` of `studio`.
"""

from collections import Counter
from collections.abc import Sequence

import bmesh
import bpy
import numpy as np

import environment

environment.import_farfield()

from farfield.addon.bridge.btf_octahedral import Impostor, impostor
from farfield.addon.bridge.btf_octahedral_capture import capture_atlas, surface_varies
from farfield.addon.bridge.meshes import SURFACE_TYPES, take
from farfield.addon.core.btf.octahedral import FrameGrid, frame_pixels
from farfield.addon.core.errors import GeometryError, SettingsError
from farfield.addon.core.mesh import longest_side
from farfield.addon.core.progress import Steps

FRAMES = 12
ROUNDS = 12  # of halving the interval of Decimate's ratio
WELDED = 1e-6  # of the longest side: vertices nearer than that are one
MAPS = 2  # colour with alpha, normal with height; a third where roughness or metallic differ


def octahedral_impostor(
    objects: Sequence[bpy.types.Object], total_bytes: int, samples: int, frames: int = FRAMES, upper: bool = False
) -> Steps[Impostor]:
    """An impostor of `objects` whose images take at most, and nearly, `total_bytes` without compression.

    `samples` are Cycles samples a pixel of its frames, which stand above the horizon alone where `upper`. Raises what
    `capture_atlas` does, and SettingsError when the bytes do not go round.
    """
    source = take(list(objects), bpy.context.evaluated_depsgraph_get())
    pixels = frame_pixels(total_bytes, frames, MAPS + surface_varies(source))
    atlas = yield from capture_atlas(source, FrameGrid(frames, upper), pixels, samples)
    made = impostor(f"{source.name} Impostor", atlas)
    for item in made.objects:
        bpy.context.scene.collection.objects.link(item)
    return made


def decimated(objects: Sequence[bpy.types.Object], triangles: int) -> bpy.types.Object:
    """A copy of `objects` as they are evaluated, joined to one mesh and collapsed by Decimate to at most, and nearly, `triangles`.

    It wears the original's materials with their UV maps and colours. Decimate takes whole leaf cards away where it can take nothing else;
    the cards that are left keep their size.

    Raises:
        SettingsError: when Decimate cannot get down to so few triangles.
        GeometryError: when the objects have no faces.
    """
    joined = _joined(objects)
    whole = _triangle_count(joined)
    modifier = joined.modifiers.new("Decimate", "DECIMATE")
    modifier.use_collapse_triangulate = True
    low, high = 0.0, min(triangles / whole, 1.0)
    modifier.ratio = high
    if _triangle_count(joined) > triangles:
        for _ in range(ROUNDS):
            modifier.ratio = 0.5 * (low + high)
            low, high = (modifier.ratio, high) if _triangle_count(joined) <= triangles else (low, modifier.ratio)
        modifier.ratio = low
    left = _triangle_count(joined)
    if not 0 < left <= triangles:
        _remove(joined)
        raise SettingsError(f'Decimate cannot bring "{objects[0].name}" with its {whole:,} triangles down to {triangles:,}; ask for more.')
    collapsed = bpy.data.meshes.new_from_object(joined.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    collapsed.name = f"{objects[0].name} Decimated"
    joined.modifiers.clear()
    uncollapsed, joined.data = joined.data, collapsed
    bpy.data.meshes.remove(uncollapsed)
    return joined


def _joined(objects: Sequence[bpy.types.Object]) -> bpy.types.Object:
    """All surfaces of `objects` and of the instances they make as one new object in the frame of the first, equal vertices welded.

    Importers leave a vertex for each corner of a face; without welding, collapsing tears every seam open.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    frame = objects[0].evaluated_get(depsgraph).matrix_world.copy()
    meshes = []
    for instance in depsgraph.object_instances:
        owner = (instance.parent if instance.is_instance else instance.object).original
        if owner in objects and instance.object.type in SURFACE_TYPES and (instance.is_instance or instance.show_self):
            mesh = bpy.data.meshes.new_from_object(instance.object, preserve_all_data_layers=True, depsgraph=depsgraph)
            matrix = frame.inverted() @ instance.matrix_world
            mesh.transform(matrix)
            if matrix.determinant() < 0.0:
                mesh.flip_normals()
            meshes.append(mesh)
    if not any(len(mesh.polygons) for mesh in meshes):
        bpy.data.batch_remove(meshes)
        raise GeometryError(f'"{objects[0].name}" has no faces to decimate; choose a visible object with faces.')
    made = [bpy.data.objects.new(f"{objects[0].name} Decimated", mesh) for mesh in meshes]
    for item in made:
        bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    if len(made) > 1:
        with bpy.context.temp_override(active_object=made[0], object=made[0], selected_editable_objects=made):
            bpy.ops.object.join()
        bpy.data.batch_remove(meshes[1:])
    made[0].matrix_world = frame
    _weld(made[0].data)
    return made[0]


def _weld(mesh: bpy.types.Mesh) -> None:
    """Join vertices at one place, but for those of faces that lie upon each other: fronts and backs of leaf cards stay two."""
    places = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", places)
    nearest = WELDED * longest_side(places.reshape(-1, 3))
    _, numbers = np.unique(np.rint(places.reshape(-1, 3) / max(nearest, 1e-30)), axis=0, return_inverse=True)
    corners = [frozenset(numbers.ravel()[list(polygon.vertices)].tolist()) for polygon in mesh.polygons]
    faces_of = Counter(corners)
    double = {vertex for polygon, key in zip(mesh.polygons, corners, strict=True) if faces_of[key] > 1 for vertex in polygon.vertices}
    _free_normals(mesh)
    shape = bmesh.new()
    shape.from_mesh(mesh)
    bmesh.ops.remove_doubles(shape, verts=[vertex for vertex in shape.verts if vertex.index not in double], dist=nearest)
    shape.to_mesh(mesh)
    shape.free()


def _free_normals(mesh: bpy.types.Mesh) -> None:
    """Keep the shading normals as plain vectors; otherwise they are stored by the faces around, which welding changes."""
    normals = np.empty(3 * len(mesh.loops), np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    if "custom_normal" in mesh.attributes:
        mesh.attributes.remove(mesh.attributes["custom_normal"])
    mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "CORNER").data.foreach_set("vector", normals)


def _triangle_count(item: bpy.types.Object) -> int:
    """Triangles of an object as it is evaluated."""
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return sum(polygon.loop_total - 2 for polygon in evaluated.data.polygons)


def _remove(item: bpy.types.Object) -> None:
    bpy.data.batch_remove([item, item.data])
