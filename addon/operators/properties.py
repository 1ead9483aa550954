"""Blender properties made from a tool's settings, and the settings read back out of them.

On panels people see their own units: shares in per cent, angles in degrees (Blender keeps those in radians itself).
"""

import math
from typing import Any

import bpy

from ..core.settings import Description, Settings, Unit, describe

SUBTYPES = {Unit.SHARE: "PERCENTAGE", Unit.ANGLE: "ANGLE", Unit.PIXELS: "PIXEL", Unit.LENGTH: "DISTANCE"}


def annotations(settings_type: type[Settings], options: set[str]) -> dict[str, Any]:
    """One Blender property a setting, as the annotations of a property group or operator class."""
    return {description.name: blender_property(description, options) for description in describe(settings_type)}


def blender_property(description: Description, options: set[str]) -> Any:
    """The Blender property that holds one setting in the units of people."""
    common = {"name": title(description), "description": description.help, "options": options}
    if description.choices:
        items = [(word, word.replace("_", " ").capitalize(), text) for word, text in description.choices.items()]
        return bpy.props.EnumProperty(items=items, default=description.default, **common)
    if description.type is bool:
        return bpy.props.BoolProperty(default=description.default, **common)
    if description.type is str:
        return bpy.props.StringProperty(default=description.default, **common)
    if description.type is tuple:
        return bpy.props.FloatVectorProperty(size=len(description.default), default=description.default, precision=3, **common)
    limits = {
        word: to_blender(description, limit)
        for word, limit in (("min", description.minimum), ("max", description.maximum))
        if limit is not None
    }
    default = to_blender(description, description.default)
    if description.type is int:
        return bpy.props.IntProperty(default=default, **limits, **common)
    return bpy.props.FloatProperty(default=default, precision=2, subtype=SUBTYPES.get(description.unit, "NONE"), **limits, **common)


def title(description: Description) -> str:
    """The name that panels show: `Max Normal Deviation`, `Texture MB`, `UV Map`."""
    return description.name.replace("_", " ").title().replace(" Mb", " MB").replace("Uv ", "UV ")


def to_blender(description: Description, value: Any) -> Any:
    """A setting's value as its Blender property holds it."""
    return value * 100.0 if description.unit is Unit.SHARE else value


def from_blender(description: Description, value: Any) -> Any:
    """The inverse of `to_blender`. Blender's floats are single precision: rounding undoes that, so that limits are met exactly."""
    if description.type is tuple:
        return tuple(_rounded(number) for number in value)
    if description.type is not float:
        return value
    if description.unit is Unit.ANGLE:
        return math.radians(_rounded(math.degrees(value)))
    return _rounded(value / 100.0 if description.unit is Unit.SHARE else value)


def read(settings_type: type[Settings], holder: Any) -> Settings:
    """The settings that a property group or operator made from `annotations` holds.

    Raises:
        SettingsError: when a value is out of its range.
    """
    return settings_type(**{item.name: from_blender(item, getattr(holder, item.name)) for item in describe(settings_type)})


def fill_unset(settings_type: type[Settings], operator: bpy.types.Operator, group: bpy.types.PropertyGroup) -> None:
    """Give each property that the caller of `operator` did not set the value that the panel shows."""
    for description in describe(settings_type):
        if not operator.properties.is_property_set(description.name):
            setattr(operator, description.name, getattr(group, description.name))


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
