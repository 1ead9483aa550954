"""Lengths as text, in the units of a scene."""

import bpy


def format_length(scene: bpy.types.Scene, length: float) -> str:
    """Return a length in scene units with three significant digits and its unit: "45.3 m", "2.32 km"; without one if the scene has none."""
    units = scene.unit_settings
    return bpy.utils.units.to_string(units.system, "LENGTH", length * units.scale_length, precision=3).strip()
