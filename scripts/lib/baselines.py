"""Baselines for relightable clouds: octahedral impostors with as many bytes, and decimated meshes with as many triangles.

Both are new objects in the scene's collection, next to their sources. An impostor must face the viewer of each render: call
`baseline.face_viewer(direction)` before `studio.render(baseline.objects, direction, ...)`.
"""

from collections import Counter
from collections.abc import Sequence

import bmesh
import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.btf.export.octahedral_capture import capture_atlas
from farfield.addon.bridge.geometry.mesh_arrays import read_positions, read_values, write_attribute
from farfield.addon.bridge.geometry.meshes import Source, read_source, visible_meshes
from farfield.addon.core.btf.octahedral import MIN_FRAME_RESOLUTION, FrameGrid
from farfield.addon.core.errors import GeometryError, SettingsError
from farfield.addon.core.geometry.mesh import longest_side
from farfield.addon.core.jobs.progress import Steps, run_to_end
from lib.impostors import Impostor, build_impostor

DEFAULT_FRAMES = 12  # along each side of the impostor's grid
BISECTION_STEPS = 12  # for the ratio of the Decimate modifier
MERGE_DISTANCE = 1e-6  # relative to the longest side
BASE_MAP_COUNT = 2  # color with alpha, normal with height; a third map where roughness or metallic vary
PROBE_CHANNELS = ("color", "roughness_metallic_depth")
PROBE_FRAMES_PER_SIDE, PROBE_RESOLUTION, PROBE_SAMPLES = 4, 32, 4  # These renders decide whether roughness and metallic need a map.


def build_octahedral_impostor(
    objects: Sequence[bpy.types.Object], total_bytes: int, samples: int, frames: int = DEFAULT_FRAMES, upper_hemisphere: bool = False
) -> Steps[Impostor]:
    """Build an impostor of `objects` whose images take at most, and nearly, `total_bytes` uncompressed.

    Its frames are rendered with `samples` Cycles samples per pixel, only from above the horizon if `upper_hemisphere`. Raises the errors of
    `capture_atlas`, and SettingsError when the bytes are too few.
    """
    source = read_source(list(objects), bpy.context.evaluated_depsgraph_get())
    pixels = compute_frame_resolution(total_bytes, frames, BASE_MAP_COUNT + has_varying_surface(source))
    atlas = yield from capture_atlas(source, FrameGrid(frames, upper_hemisphere), pixels, samples)
    impostor = build_impostor(f"{source.name} Impostor", atlas)
    for item in impostor.objects:
        bpy.context.scene.collection.objects.link(item)
    return impostor


def has_varying_surface(source: Source) -> bool:
    """Whether roughness or metallic of `source` vary over its surface, from a few small renders. Raises as `capture_atlas`."""
    steps = capture_atlas(source, FrameGrid(PROBE_FRAMES_PER_SIDE), PROBE_RESOLUTION, PROBE_SAMPLES, channels=PROBE_CHANNELS)
    return run_to_end(steps).uniform_roughness_metallic is None


def compute_frame_resolution(total_bytes: int, frames_per_side: int, image_count: int) -> int:
    """Return the largest frame resolution with which `image_count` images, four bytes per pixel, uncompressed, fit into `total_bytes`.

    Raises:
        SettingsError: the frames would be too small.
    """
    resolution = int((total_bytes / (4.0 * image_count)) ** 0.5 / frames_per_side)
    if resolution < MIN_FRAME_RESOLUTION:
        raise SettingsError(
            f"{total_bytes:,} bytes are too few for an octahedral atlas of {frames_per_side} x {frames_per_side} frames: each would have "
            f"{resolution} pixels per side. Use at least {4 * image_count * (MIN_FRAME_RESOLUTION * frames_per_side) ** 2:,} bytes."
        )
    return resolution


def decimate(objects: Sequence[bpy.types.Object], triangles: int) -> bpy.types.Object:
    """Return the evaluated `objects` joined to one mesh and collapsed by the Decimate modifier to at most, and nearly, `triangles`.

    The result keeps the materials, UV maps and color attributes. Where nothing else can be collapsed, Decimate removes whole leaf cards;
    the remaining cards keep their size.

    Raises:
        SettingsError: Decimate cannot reach so few triangles.
        GeometryError: the objects have no faces.
    """
    joined = _join(objects)
    total = _triangle_count(joined)
    modifier = joined.modifiers.new("Decimate", "DECIMATE")
    modifier.use_collapse_triangulate = True
    _search_ratio(joined, modifier, triangles, min(triangles / total, 1.0))
    remaining = _triangle_count(joined)
    if not 0 < remaining <= triangles:
        _remove(joined)
        raise SettingsError(
            f'Decimate cannot reduce "{objects[0].name}" from {total:,} to {triangles:,} triangles; use a larger number of triangles.'
        )
    collapsed = bpy.data.meshes.new_from_object(joined.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    collapsed.name = f"{objects[0].name} Decimated"
    joined.modifiers.clear()
    uncollapsed, joined.data = joined.data, collapsed
    bpy.data.meshes.remove(uncollapsed)
    return joined


def _search_ratio(joined: bpy.types.Object, modifier: bpy.types.DecimateModifier, triangles: int, high: float) -> None:
    """Set the largest ratio, at most `high`, at which `joined` has at most `triangles`; found by bisection."""
    modifier.ratio = high
    if _triangle_count(joined) <= triangles:
        return
    low = 0.0
    for _ in range(BISECTION_STEPS):
        modifier.ratio = 0.5 * (low + high)
        low, high = (modifier.ratio, high) if _triangle_count(joined) <= triangles else (low, modifier.ratio)
    modifier.ratio = low


def _join(objects: Sequence[bpy.types.Object]) -> bpy.types.Object:
    """Join the evaluated meshes of `objects` and their instances as a new object in the space of the first, with equal vertices merged.

    Importers create one vertex per face corner; unless they are merged, collapsing tears open every seam.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    frame = objects[0].evaluated_get(depsgraph).matrix_world.copy()
    meshes = []
    for _, instance in visible_meshes({item.name_full for item in objects}, depsgraph):
        mesh = bpy.data.meshes.new_from_object(instance.object, preserve_all_data_layers=True, depsgraph=depsgraph)
        matrix = frame.inverted() @ instance.matrix_world
        mesh.transform(matrix)
        if matrix.determinant() < 0.0:
            mesh.flip_normals()
        meshes.append(mesh)
    if not any(len(mesh.polygons) for mesh in meshes):
        bpy.data.batch_remove(meshes)
        raise GeometryError(f'"{objects[0].name}" has no faces to decimate; select a visible object with faces.')
    parts = [bpy.data.objects.new(f"{objects[0].name} Decimated", mesh) for mesh in meshes]
    for item in parts:
        bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    if len(parts) > 1:
        with bpy.context.temp_override(active_object=parts[0], object=parts[0], selected_editable_objects=parts):
            bpy.ops.object.join()
        bpy.data.batch_remove(meshes[1:])
    parts[0].matrix_world = frame
    _merge_vertices(parts[0].data)
    return parts[0]


def _merge_vertices(mesh: bpy.types.Mesh) -> None:
    """Merge vertices at the same position, except those of coincident faces: the fronts and backs of leaf cards stay separate."""
    positions = read_positions(mesh)
    distance = MERGE_DISTANCE * longest_side(positions)
    _, indices = np.unique(np.rint(positions / max(distance, 1e-30)), axis=0, return_inverse=True)
    corners = [frozenset(indices.ravel()[list(polygon.vertices)].tolist()) for polygon in mesh.polygons]
    face_counts = Counter(corners)
    coincident = {
        vertex for polygon, key in zip(mesh.polygons, corners, strict=True) if face_counts[key] > 1 for vertex in polygon.vertices
    }
    _store_free_normals(mesh)
    edited = bmesh.new()
    edited.from_mesh(mesh)
    bmesh.ops.remove_doubles(edited, verts=[vertex for vertex in edited.verts if vertex.index not in coincident], dist=distance)
    edited.to_mesh(mesh)
    edited.free()


def _store_free_normals(mesh: bpy.types.Mesh) -> None:
    """Store the shading normals as plain vectors. Custom normals are relative to the adjacent faces, which merging vertices changes."""
    normals = read_values(mesh.corner_normals, "vector", 3)
    if "custom_normal" in mesh.attributes:
        mesh.attributes.remove(mesh.attributes["custom_normal"])
    write_attribute(mesh, "custom_normal", "CORNER", normals)


def _triangle_count(item: bpy.types.Object) -> int:
    """Return the number of triangles of an evaluated object."""
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return sum(polygon.loop_total - 2 for polygon in evaluated.data.polygons)


def _remove(item: bpy.types.Object) -> None:
    bpy.data.batch_remove([item, item.data])
