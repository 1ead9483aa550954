"""What renderers and materials read from an object, apart from its data and its place: for objects that stand for another one."""

import bpy

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
