"""Levels of a cloud compared with what Blender's Decimate makes of the same source with as many triangles.

Source, level and mesh are rendered with Cycles, with their materials, from a few views where the error of the level is one pixel: from
farther away, nobody sees the difference better. This costs a few percent of a build.
"""

import math
from collections.abc import Sequence

import bpy
import mathutils
import numpy as np

from ...core.billboards.comparison import LevelComparison, measure_difference
from ...core.geometry.cameras import OrthographicView
from ...core.geometry.directions import from_spherical
from ...core.jobs.progress import Progress, Steps
from ..cameras import light_matrix, set_camera_view
from ..geometry.joined_meshes import find_frame, join_instances
from ..geometry.mesh_arrays import count_triangles
from ..geometry.mesh_writing import write_evaluated_mesh
from ..geometry.meshes import Source
from ..lod_sets import ERROR
from ..objects import instances_lights
from ..rendering.render_properties import copy_render_properties
from ..rendering.render_scene import RenderScene, prepare_cycles, render_scene
from ..shading.scene_space_nodes import reads_object

VIEWS = from_spherical(np.array([[1.0, 0.6], [1.35, 2.7], [0.7, 4.8]]))
SUNS = (*from_spherical(np.array([[0.6, 2.0], [1.3, 4.4]])), None)  # High, low, and the sky alone: one per view.
SUN_STRENGTH, SUN_ANGLE = 3.0, 0.05  # W/m2, and radians across the disc.
SKY_RADIANCE = 0.3
SAMPLES = 4  # Per pixel. The mean visible difference hardly depends on them.
MAX_TRANSPARENT_BOUNCES = 256
MAX_PIXELS = 360  # Along the side of a render, those of an error of 0.5 %; finer levels would take too long to compare.
MAX_TRIANGLES = 300_000  # Of the source: Decimate would take longer than is worth it.
MARGIN = 6  # Pixels around the object.
MAX_EXCESS = 1.02  # Triangles of a decimated mesh over those of the level.
ATTEMPTS = 6


def can_compare(source: Source, objects: Sequence[bpy.types.Object]) -> bool:
    """Return whether a decimated mesh of `source`, which was read from `objects`, can be rendered in moderate time and looks like it."""
    if source.mesh is None or len(source.mesh.triangles) > MAX_TRIANGLES:
        return False
    if instances_lights(objects):
        return False
    # One mesh of several objects has one position and random number only.
    trees = [material.node_tree for material in source.materials if material.node_tree is not None]
    return not any(reads_object(tree, len(source.instances) > 1) for tree in trees)


def compare_with_decimate(
    source: Source, objects: Sequence[bpy.types.Object], levels: Sequence[bpy.types.Object]
) -> Steps[list[LevelComparison]]:
    """Compare `levels`, finest first, with decimated meshes of `source`, which was read from `objects`. See `can_compare`.

    Levels that are as heavy as the source, or too fine for a small render, are left out.

    Raises:
        FileError: the temporary folder cannot hold a render.
        FarfieldError: Cycles is disabled.
    """
    comparisons = []
    with render_scene("Farfield Comparison") as work:
        joined = _add_joined_mesh(work, source, objects)
        total, sun = len(joined.data.polygons), _prepare_scene(work)
        with work.show([*objects, *levels]):
            for index, level in enumerate(levels):
                view_size = _find_size(source, level[ERROR])
                count = count_triangles(level.data)
                if count >= total or view_size > MAX_PIXELS:
                    continue
                yield Progress(index / len(levels), "Comparing with Decimate")
                decimated = _decimate(work, joined, count)
                shown = [list(objects), [level], [] if decimated is None else [decimated]]
                renders = _render(work, sun, shown, source, level[ERROR], view_size)
                mesh = None if decimated is None else measure_difference(renders[0], renders[2])
                comparisons.append(LevelComparison(index, count, measure_difference(renders[0], renders[1]), mesh))
    return comparisons


def _prepare_scene(work: RenderScene) -> bpy.types.Object:
    """Set up the lights and Cycles, and return the Sun."""
    prepare_cycles(work.scene, SAMPLES, MAX_TRANSPARENT_BOUNCES)
    work.scene.world = work.add_world(SKY_RADIANCE)
    light = work.own(bpy.data.lights.new("Farfield Comparison", "SUN"))
    light.energy, light.angle = SUN_STRENGTH, SUN_ANGLE
    return work.add_object(light)


def _find_size(source: Source, error: float) -> int:
    """Return the side in pixels of a view of the whole source whose pixels have the side `error`."""
    return math.ceil(2.0 * _bounding_sphere(source)[1] / error) + 2 * MARGIN


def _bounding_sphere(source: Source) -> tuple[np.ndarray, float]:
    low, high = source.mesh.vertices.min(axis=0), source.mesh.vertices.max(axis=0)
    return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))


def _render(
    work: RenderScene, sun: bpy.types.Object, shown: Sequence[Sequence[bpy.types.Object]], source: Source, pixel_size: float, size: int
) -> list[list[np.ndarray]]:
    """Return renders (S, S, 4) from all VIEWS of each of the groups of objects `shown`."""
    center, _ = _bounding_sphere(source)
    renders: list[list[np.ndarray]] = [[] for _ in shown]
    for direction, sun_direction in zip(VIEWS, SUNS, strict=True):
        set_camera_view(work.scene, OrthographicView(direction, center, size, pixel_size))
        sun.hide_render = sun_direction is None
        if sun_direction is not None:
            sun.matrix_world = light_matrix(sun_direction)
        for images, items in zip(renders, shown, strict=True):
            if items:
                work.show_only(items)
                images.append(work.render())
    return renders


def _add_joined_mesh(work: RenderScene, source: Source, objects: Sequence[bpy.types.Object]) -> bpy.types.Object:
    """Add one object with everything that the source shows, in the space of its only object or at its origin."""
    frame = np.eye(4)
    frame[:3, 3] = source.origin
    if len(objects) == 1:
        frame = find_frame(np.array(objects[0].matrix_world))
    mesh = work.own(bpy.data.meshes.new("Farfield Decimated"))
    write_evaluated_mesh(mesh, join_instances(source.instances, np.linalg.inv(frame)))
    joined = work.add_object(mesh)
    copy_render_properties(objects[0], joined)
    joined.matrix_world = mathutils.Matrix(frame.tolist())
    return joined


def _decimate(work: RenderScene, joined: bpy.types.Object, count: int) -> bpy.types.Object | None:
    """Add a copy of `joined` that Decimate has reduced to nearly `count` triangles, or fewer; None if it cannot reach so few."""
    modifier = joined.modifiers.new("Decimate", "DECIMATE")
    modifier.use_collapse_triangulate = True
    ratio, view_layer = count / len(joined.data.polygons), work.scene.view_layers[0]
    try:
        for _ in range(ATTEMPTS):
            modifier.ratio = ratio
            view_layer.update()
            evaluated = joined.evaluated_get(view_layer.depsgraph)
            reached = len(evaluated.data.polygons)
            if 0 < reached <= MAX_EXCESS * count:
                mesh = work.own(bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=view_layer.depsgraph))
                decimated = work.add_object(mesh)
                copy_render_properties(joined, decimated)
                decimated.matrix_world = joined.matrix_world
                return decimated
            ratio *= min(count / max(reached, 1), 0.95)
        return None
    finally:
        joined.modifiers.remove(modifier)
