"""A closed surface unwrapped by Blender along the same cuts, by Farfield, and by Farfield with importance towards the viewer."""

from dataclasses import dataclass

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.geometry.mesh_arrays import read_uvs, write_uvs
from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.distortion import DistortionMetrics, compute_stretches, draw_stretch_image, measure_distortion
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.unwrap.job import prepare
from lib.demo_materials import create_material

CHECKER_SCALE = 70.0  # fields per side of a square with the area of the map
UV_MAP = "Unwrap"


@dataclass(frozen=True)
class UnwrappedCopy:
    """A copy of the surface with a checker on its UV map, the metrics of the map, and its image colored by stretch."""

    item: bpy.types.Object
    metrics: DistortionMetrics
    stretch_image: np.ndarray


def unwrap_copies(item: bpy.types.Object, viewer: np.ndarray, pixels: int) -> list[UnwrappedCopy]:
    """Return copies of `item`, a closed mesh, unwrapped by Blender, by Farfield, and by Farfield with importance towards `viewer` (3,)."""
    uniform = UnwrapSettings(uv_map=UV_MAP)
    towards_viewer = UnwrapSettings(importance="direction", direction=tuple(viewer.tolist()), uv_map=UV_MAP)
    farfield_copy, blender_copy, viewer_copy = (duplicate(item) for _ in range(3))
    unwrap(farfield_copy, uniform)
    layer = blender_copy.data.uv_layers.new(name=UV_MAP)
    write_uvs(layer, read_uvs(farfield_copy.data.uv_layers[UV_MAP]))
    unwrap_with_blender(blender_copy)
    unwrap(viewer_copy, towards_viewer)
    return [measure_copy(copy, pixels) for copy in (blender_copy, farfield_copy, viewer_copy)]


def duplicate(item: bpy.types.Object) -> bpy.types.Object:
    """Add a copy of an object, with its own mesh, to the scene."""
    copy = item.copy()
    copy.data = item.data.copy()
    bpy.context.collection.objects.link(copy)
    bpy.context.view_layer.update()
    return copy


def unwrap(item: bpy.types.Object, settings: UnwrapSettings) -> None:
    """Unwrap with Farfield."""
    run_to_end(run_job(prepare(bpy.context, [item], settings)))


def unwrap_with_blender(item: bpy.types.Object) -> None:
    """Unwrap with Blender's Minimum Stretch, cut at the UV island boundaries of the existing UV map."""
    bpy.ops.object.select_all(action="DESELECT")
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.seams_from_islands()
    bpy.ops.uv.unwrap(method="MINIMUM_STRETCH", margin=0.004)
    bpy.ops.object.mode_set(mode="OBJECT")


def measure_copy(item: bpy.types.Object, pixels: int) -> UnwrappedCopy:
    """Measure the UV map of a copy, and give it a checker with the same scale on the surface for every map."""
    target = uv_maps.read_uv_target(item, None)
    corner_uvs = read_uvs(item.data.uv_layers[UV_MAP])[target.loops].astype(np.float64)
    stretches = run_to_end(compute_stretches(target.mesh, corner_uvs))
    metrics = run_to_end(measure_distortion(target.mesh, corner_uvs, stretches, np.zeros(len(corner_uvs))))
    item.data.materials.clear()
    item.data.materials.append(create_checker(CHECKER_SCALE / np.sqrt(metrics.fill)))
    return UnwrappedCopy(item, metrics, draw_stretch_image(corner_uvs, stretches.dominant, pixels))


def create_checker(scale: float) -> bpy.types.Material:
    """Create a checker with `scale` fields per side of the UV square."""
    material, nodes, links, surface = create_material("Checker")
    uv_map, checker = nodes.new("ShaderNodeUVMap"), nodes.new("ShaderNodeTexChecker")
    uv_map.uv_map = UV_MAP
    checker.inputs["Scale"].default_value = scale
    checker.inputs["Color1"].default_value, checker.inputs["Color2"].default_value = (0.75, 0.72, 0.66, 1.0), (0.10, 0.14, 0.20, 1.0)
    links.new(uv_map.outputs["UV"], checker.inputs["Vector"])
    links.new(checker.outputs["Color"], surface.inputs["Base Color"])
    surface.inputs["Roughness"].default_value = 0.6
    return material
