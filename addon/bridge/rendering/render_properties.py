"""What renderers and materials read from an object that stands for another one, apart from its data and its place, and the number of
transparent bounces that Cycles needs for quads behind quads."""

import math
from collections.abc import Sequence

import bpy
import numpy as np

from ...core.arrays import TINY
from ..geometry.mesh_arrays import read_positions

PROPERTIES = (  # those that a version of Blender lacks are left out
    "color",
    "pass_index",
    "lightgroup",
    "display_type",
    "show_in_front",
    "is_holdout",
    "is_shadow_catcher",
    "visible_camera",
    "visible_diffuse",
    "visible_glossy",
    "visible_transmission",
    "visible_volume_scatter",
    "visible_shadow",
    "visible_raycast",
    "hide_probe_volume",
    "hide_probe_sphere",
    "hide_probe_plane",
    "shadow_terminator_normal_offset",
    "shadow_terminator_geometry_offset",
    "shadow_terminator_shading_offset",
)
CYCLES_PROPERTIES = ("use_camera_cull", "use_distance_cull", "ao_distance", "is_caustics_caster", "is_caustics_receiver")
LINKED_COLLECTIONS = ("receiver_collection", "blocker_collection")
MIN_BOUNCES, MAX_BOUNCES = 32.0, 1024.0  # the maximum is that of Cycles
OWN_PREFIX = "farfield_"  # Custom properties that describe the object itself begin with it.


def copy_render_properties(source: bpy.types.Object, target: bpy.types.Object) -> None:
    """Copy visibility for rays, holdout, shadow catcher and terminator, caustics, culling, light linking, light group, pass index, color,
    how viewports show the object, and the custom properties that Attribute nodes read. Custom properties of `target` stay."""
    _copy(source, target, PROPERTIES)
    for name in LINKED_COLLECTIONS:
        collection = getattr(source.light_linking, name)
        setattr(target.light_linking, name, None if collection is None else collection.original)
    if hasattr(source, "cycles") and hasattr(target, "cycles"):  # the add-on of Cycles can be disabled
        _copy(source.cycles, target.cycles, CYCLES_PROPERTIES)
    for key in source.keys():  # noqa: SIM118 - an object is not a dict
        if not key.startswith(OWN_PREFIX) and key not in target:
            target[key] = source[key]


def _copy(source: bpy.types.bpy_struct, target: bpy.types.bpy_struct, names: tuple[str, ...]) -> None:
    for name in names:
        if hasattr(source, name):
            setattr(target, name, getattr(source, name))


def estimate_transparent_bounces(levels: Sequence[bpy.types.Object], all_visible: bool = False) -> int:
    """Estimate the transparent bounces with which Cycles shows stacked quads without rendering the deeper ones black: 32 to 1024.

    Four times the mean number of quads on a line through the bounding sphere, for the level where this is largest, or summed over the
    levels if they are `all_visible` at once.
    """
    bounces = []
    for level in levels:
        if len(level.data.polygons) == 0:  # somebody has deleted the quads
            continue
        longest_side = float(np.ptp(read_positions(level.data), axis=0).max())
        bounces.append(4.0 * sum(polygon.area for polygon in level.data.polygons) / max(0.25 * math.pi * longest_side**2, TINY))
    return int(min(max(MIN_BOUNCES, sum(bounces) if all_visible else max(bounces, default=0.0)), MAX_BOUNCES))


def ensure_transparent_bounces(scene: bpy.types.Scene, bounces: int) -> None:
    """Raise the scene's limit of transparent bounces to `bounces`. A higher limit stays. Cycles renders deeper surfaces black."""
    if hasattr(scene, "cycles"):
        scene.cycles.transparent_max_bounces = max(scene.cycles.transparent_max_bounces, bounces)
