"""Drivers of custom properties."""

import bpy


def add_scene_driver(item: bpy.types.Object, name: str, index: int, expression: str, paths: dict[str, str]) -> None:
    """Drive one component of the custom property `name` by `expression`. `paths` maps its variables to data paths of the active scene."""
    driver = _add_driver(item, name, index)
    for key, path in paths.items():
        variable = driver.variables.new()
        variable.name, variable.type = key, "CONTEXT_PROP"
        variable.targets[0].context_property = "ACTIVE_SCENE"
        variable.targets[0].data_path = path
    driver.expression = expression


def add_object_driver(
    item: bpy.types.Object, name: str, index: int, expression: str, source: bpy.types.Object, paths: dict[str, str]
) -> None:
    """Drive one component of the custom property `name` by `expression`. `paths` maps its variables to data paths of `source`."""
    driver = _add_driver(item, name, index)
    for key, path in paths.items():
        variable = driver.variables.new()
        variable.name = key
        variable.targets[0].id = source
        variable.targets[0].data_path = path
    driver.expression = expression


def _add_driver(item: bpy.types.Object, name: str, index: int) -> bpy.types.Driver:
    driver = item.driver_add(f'["{name}"]', index).driver
    driver.type = "SCRIPTED"
    return driver
