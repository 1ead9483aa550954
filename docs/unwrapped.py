"""A closed surface unwrapped three times: by Blender along the same cuts, by Farfield, and by Farfield for the side that is looked at."""

from dataclasses import dataclass

import bpy
import numpy as np

import environment

environment.import_farfield()

from demo_materials import new_material
from farfield.addon.bridge import uv_maps
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap.measures import Measures, measured, stretches_of
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.stretch_colors import stretch_picture
from farfield.addon.operators.long_work import whole
from farfield.addon.operators.unwrap_job import prepare

CHECKS = 70.0  # along the side of a square as large as the map
MAP = "Unwrap"


@dataclass(frozen=True)
class UnwrappedCopy:
    """A copy of the surface that wears a checker by its UV map; the map's figures, and its coloured picture."""

    item: bpy.types.Object
    figures: Measures
    picture: np.ndarray


def unwrapped_copies(item: bpy.types.Object, viewer: np.ndarray, pixels: int) -> list[UnwrappedCopy]:
    """Copies of `item`, a closed mesh: by Blender, by Farfield, and by Farfield with importance towards the `viewer` (3,)."""
    even = UnwrapSettings(uv_map=MAP)
    front = UnwrapSettings(importance="direction", direction=tuple(viewer.tolist()), uv_map=MAP)
    ours, theirs, best = (duplicate(item) for _ in range(3))
    unwrap(ours, even)
    layer = theirs.data.uv_layers.new(name=MAP)
    layer.uv.foreach_set("vector", uv_maps.uvs_of(ours.data.uv_layers[MAP]).ravel())
    unwrap_with_blender(theirs)
    unwrap(best, front)
    return [finished(copy, pixels) for copy in (theirs, ours, best)]


def duplicate(item: bpy.types.Object) -> bpy.types.Object:
    """A copy of an object, with a mesh of its own, in the scene."""
    copy = item.copy()
    copy.data = item.data.copy()
    bpy.context.collection.objects.link(copy)
    return copy


def unwrap(item: bpy.types.Object, settings: UnwrapSettings) -> None:
    """Unwrap with Farfield."""
    finish(whole(prepare(bpy.context, [item], settings)))


def unwrap_with_blender(item: bpy.types.Object) -> None:
    """Unwrap with Blender's Minimum Stretch, cut where the UV map that there is has its borders."""
    bpy.ops.object.select_all(action="DESELECT")
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.seams_from_islands()
    bpy.ops.uv.unwrap(method="MINIMUM_STRETCH", margin=0.004)
    bpy.ops.object.mode_set(mode="OBJECT")


def finished(item: bpy.types.Object, pixels: int) -> UnwrappedCopy:
    """The copy with a checker as fine on every map, and what its map is worth."""
    target = uv_maps.take(item, None)
    corners = uv_maps.uvs_of(item.data.uv_layers[MAP])[target.loops].astype(np.float64)
    stretches = finish(stretches_of(target.mesh, corners))
    figures = finish(measured(target.mesh, corners, stretches, np.zeros(len(corners))))
    item.data.materials.clear()
    item.data.materials.append(checker(CHECKS / np.sqrt(figures.fill)))
    return UnwrappedCopy(item, figures, stretch_picture(corners, stretches.largest, pixels))


def checker(scale: float) -> bpy.types.Material:
    """A checker with `scale` fields along the side of the UV square."""
    material, nodes, links, surface = new_material("Checker")
    place, fields = nodes.new("ShaderNodeUVMap"), nodes.new("ShaderNodeTexChecker")
    place.uv_map = MAP
    fields.inputs["Scale"].default_value = scale
    fields.inputs["Color1"].default_value, fields.inputs["Color2"].default_value = (0.75, 0.72, 0.66, 1.0), (0.10, 0.14, 0.20, 1.0)
    links.new(place.outputs["UV"], fields.inputs["Vector"])
    links.new(fields.outputs["Color"], surface.inputs["Base Color"])
    surface.inputs["Roughness"].default_value = 0.6
    return material
