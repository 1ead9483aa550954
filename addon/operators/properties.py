"""Blender properties built from a tool's settings, and settings read back from such properties.

Properties hold the units of the interface: fractions as percentages. Angles stay in radians, which Blender shows as degrees.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import bpy

from ..core.errors import FileError
from ..core.settings import Description, Settings, Unit, describe
from .user_cache import process_count

NUMBER_SUBTYPES = {
    Unit.FRACTION: "PERCENTAGE",
    Unit.ANGLE: "ANGLE",
    Unit.LENGTH: "DISTANCE",
    Unit.SECONDS: "TIME_ABSOLUTE",
    Unit.PIXELS: "PIXEL",
}
PATH_SUBTYPES = {None: "NONE", "file": "FILE_PATH", "folder": "DIR_PATH"}


def build_annotations(settings_type: type[Settings], options: set[str]) -> dict[str, Any]:
    """Return one Blender property per setting, as annotations of a property group or operator class."""
    return {description.name: build_property(description, options) for description in describe(settings_type)}


def scene_settings_factory(
    name: str, group_type: type[bpy.types.PropertyGroup], classes: Sequence[type]
) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return a function that registers `classes`, and the settings of the panel as the property `name` of scenes, and one that undoes it.

    group_type: one of `classes`.
    """
    register_classes, unregister_classes = bpy.utils.register_classes_factory(classes)

    def register() -> None:
        register_classes()
        setattr(bpy.types.Scene, name, bpy.props.PointerProperty(type=group_type))

    def unregister() -> None:
        delattr(bpy.types.Scene, name)
        unregister_classes()

    return register, unregister


def build_property(description: Description, options: set[str]) -> Any:
    """Return the Blender property that holds one setting in the units of the interface."""
    common = {"name": description.label, "description": description.tooltip, "options": options}
    if description.choices:
        items = [(value, choice.label, choice.help) for value, choice in description.choices.items()]
        return bpy.props.EnumProperty(items=items, default=description.default, **common)
    if description.type is bool:
        return bpy.props.BoolProperty(default=description.default, **common)
    if description.type is str:
        if description.path is not None:
            common["options"] = options | {"PATH_SUPPORTS_BLEND_RELATIVE"}
        return bpy.props.StringProperty(default=description.default, subtype=PATH_SUBTYPES[description.path], **common)
    if description.is_color:
        limits = {"min": 0.0, "max": 1.0}
        return bpy.props.FloatVectorProperty(size=3, default=description.default, subtype="COLOR_GAMMA", **limits, **common)
    limits = {
        keyword: to_blender(description, limit)
        for keyword, limit in (("min", description.minimum), ("max", description.maximum))
        if limit is not None
    }
    default = to_blender(description, description.default)
    subtype = NUMBER_SUBTYPES.get(description.unit, "NONE")
    if description.has_integers:
        return bpy.props.IntVectorProperty(size=len(default), default=default, **limits, **common)
    if description.type is tuple:
        return bpy.props.FloatVectorProperty(size=len(default), default=default, precision=3, **limits, **common)
    if description.type is int:
        return bpy.props.IntProperty(default=default, subtype=subtype, **limits, **common)
    return bpy.props.FloatProperty(default=default, precision=2, subtype=subtype, **limits, **common)


def to_blender(description: Description, value: Any) -> Any:
    """Return the value of a setting in the units of its Blender property."""
    return value * 100.0 if description.unit is Unit.FRACTION else value


def from_blender(description: Description, value: Any) -> Any:
    """Invert `to_blender`.

    Blender's floats are single precision. Rounding to six digits undoes this, so that values at a limit are not out of range.
    """
    if description.type is tuple:
        return tuple(value) if description.has_integers else tuple(_round(number) for number in value)
    if description.type is not float:
        return value
    if description.unit is Unit.ANGLE:
        return math.radians(_round(math.degrees(value)))
    return _round(value / 100.0 if description.unit is Unit.FRACTION else value)


def read(settings_type: type[Settings], owner: Any) -> Settings:
    """Return the settings held by `owner`, a property group or operator with properties from `build_annotations`. Settings for which it has
    no property keep their defaults, and processes without a number are as many as the preferences say.

    Raises:
        SettingsError: a value is out of range.
    """
    values = {item.name: from_blender(item, getattr(owner, item.name)) for item in _find_properties(settings_type, owner)}
    if values.get("executor") == PROCESSES and process_count():
        values["executor"] = f"{PROCESSES}:{process_count()}"
    return settings_type(**values)


def fill_unset(settings_type: type[Settings], operator: bpy.types.Operator, group: bpy.types.PropertyGroup) -> None:
    """Set the properties that the caller of `operator` left unset to the values in the panel's `group`."""
    for description in _find_properties(settings_type, operator):
        if not operator.properties.is_property_set(description.name):
            setattr(operator, description.name, getattr(group, description.name))


def _find_properties(settings_type: type[Settings], owner: Any) -> list[Description]:
    return [item for item in describe(settings_type) if hasattr(owner, item.name)]


def _round(value: float) -> float:
    return float(f"{value:.6g}")


PROCESSES = "processes"  # the executor that is as many processes as the preferences say
BLEND_PREFIX = "//"  # Paths relative to the .blend file begin with it.


def absolute_path(path: str) -> Path:
    """Return an absolute path. Raises FileError if it is relative to a .blend file that was never saved."""
    if path.startswith(BLEND_PREFIX):
        if not bpy.data.filepath:
            raise FileError(f'The path "{path}" is relative to a file that was never saved; save the file or choose the path again.')
        path = bpy.path.abspath(path)
    return Path(path).absolute()
