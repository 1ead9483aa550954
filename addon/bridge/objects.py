"""Objects of a scene: found again while a job runs, their world matrices, visibility for a time, and drivers of their properties."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy
import mathutils

from .geometry import meshes
from .geometry.mesh_pool import is_local


def find_by_uid(data_blocks: Iterable[bpy.types.ID], session_uid: int) -> bpy.types.ID | None:
    """Return the one of `data_blocks`, such as `bpy.data.objects`, with this session UID; None if it was removed."""
    return next((data_block for data_block in data_blocks if data_block.session_uid == session_uid), None)


def world_matrix(item: bpy.types.Object) -> mathutils.Matrix:
    """Return the world matrix of an object. Blender does not compute `matrix_world` of objects that are hidden in an opened file."""
    if item.constraints or (item.parent is not None and item.parent_type not in {"OBJECT", "ARMATURE"}):
        return item.matrix_world
    return item.matrix_basis if item.parent is None else world_matrix(item.parent) @ item.matrix_parent_inverse @ item.matrix_basis


@contextmanager
def temporarily_visible(context: bpy.types.Context, objects: Sequence[bpy.types.Object]) -> Iterator[bpy.types.Depsgraph]:
    """Show `objects` in the viewport and yield the evaluated scene of `context`; restore their visibility afterwards.

    Objects that are not in the view layer stay as they are.
    """
    present = [item for item in objects if meshes.is_in_view_layer(item, context.view_layer)]
    visibility = [(item, item.hide_viewport, item.hide_get()) for item in present]
    try:
        for item in present:
            item.hide_viewport = False
            item.hide_set(False)
        context.view_layer.update()
        yield context.evaluated_depsgraph_get()
    finally:
        for item, hide_viewport, hidden in visibility:
            item.hide_viewport = hide_viewport
            item.hide_set(hidden)
        context.view_layer.update()


def add_scene_driver(item: bpy.types.Object, name: str, index: int, expression: str, paths: dict[str, str]) -> None:
    """Drive one component of the custom property `name` by `expression`. `paths` maps its variables to data paths of the active scene."""
    drive_by_scene(_add_driver(item, name, index), expression, paths)


def drive_by_scene(driver: bpy.types.Driver, expression: str, paths: dict[str, str]) -> None:
    """Let a new driver compute `expression`. `paths` maps its variables to data paths of the active scene."""
    driver.type = "SCRIPTED"
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


def instances_lights(objects: Sequence[bpy.types.Object]) -> bool:
    """Return whether any of `objects` is an instance of a collection with lights, which would light everything near it."""
    collections = [item.instance_collection for item in objects if item.instance_collection is not None]
    return any(item.type == "LIGHT" for collection in collections for item in collection.all_objects)


def parent_collection(source: bpy.types.Object, scene: bpy.types.Scene) -> bpy.types.Collection:
    """Return the first local collection of the scene with the source, or that of the scene."""
    within = {scene.collection, *scene.collection.children_recursive}
    return next((collection for collection in source.users_collection if collection in within and is_local(collection)), scene.collection)
