# ruff: noqa: ARG001 - functions that are chosen at random have the same arguments
"""What a user does to a scene between two operators: moves, renames, hides, removes and duplicates things, undoes, saves."""

import json
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import bpy
import campaign_scenes

import random_inputs

PREFIX = "farfield"  # Our custom properties begin with it.
BAD_PROPERTIES: tuple[Any, ...] = (
    "", "text", "[]", "null", '{"voxel_size": "a"}', '{"terrain": 5}', '{"resolution": 64.5}', '["Missing"]', "../../escaped", -1, 0, 10**6,
    2**31 - 1, math.nan, math.inf, -1.5, [0.0], [math.nan] * 3, [1, 2], [10**6, 10**6], {"a": 1}, True,
)  # fmt: skip


def change_scene(random: Random, folder: Path, record: Callable[[str], None]) -> None:
    """Do one random thing to the open scene. `record` is called with its name first."""
    action = random.choice(ACTIONS)
    record(action.__name__.strip("_"))
    with suppress(RuntimeError, ReferenceError, AttributeError):  # Blender refuses it, or the data is linked and read-only
        action(random, folder)


def _objects() -> list[bpy.types.Object]:
    return list(bpy.context.scene.objects)


def _change_object(random: Random, folder: Path) -> None:
    objects = _objects()
    if objects:
        random.choice(campaign_scenes.CHANGES)(random, random.choice(objects), objects)


def _remove_object(random: Random, folder: Path) -> None:
    if _objects():
        bpy.data.objects.remove(random.choice(_objects()))


def _remove_data(random: Random, folder: Path) -> None:
    """Remove a data-block that others may use."""
    kind = random.choice(("meshes", "materials", "images", "node_groups", "collections", "cameras"))
    blocks = list(getattr(bpy.data, kind))
    if blocks:
        getattr(bpy.data, kind).remove(random.choice(blocks))


def _rename_data(random: Random, folder: Path) -> None:
    blocks = [*bpy.data.collections, *bpy.data.objects, *bpy.data.materials, *bpy.data.images, *bpy.data.scenes]
    random.choice(blocks).name = random_inputs.random_name(random)


def _exchange_names(random: Random, folder: Path) -> None:
    if len(_objects()) > 1:
        first, second = random.sample(_objects(), 2)
        first_name, second_name = first.name, second.name
        first.name = "exchange"
        second.name, first.name = first_name, second_name


def _corrupt_property(random: Random, folder: Path) -> None:
    """Give one of our custom properties a value that we never write, as a file from elsewhere may have."""
    owners = [*bpy.data.objects, *bpy.data.collections, *bpy.data.meshes, *bpy.data.materials]
    places = [(owner, name) for owner in owners for name in owner.keys() if name.startswith(PREFIX)]  # noqa: SIM118 not a dictionary
    if not places:
        return
    owner, name = random.choice(places)
    if random.random() < 0.2:
        del owner[name]
        return
    value = owner[name]
    if isinstance(value, str) and value.startswith("{") and random.random() < 0.6:
        with suppress(ValueError):
            fields = json.loads(value)
            fields[random.choice(list(fields))] = random.choice(("a", -1, 1e30, None, [], {}, 64.5))
            owner[name] = json.dumps(fields)
            return
    with suppress(TypeError, OverflowError):  # Blender does not store it
        owner[name] = random.choice(BAD_PROPERTIES)


def _exclude_collection(random: Random, folder: Path) -> None:
    children = list(bpy.context.view_layer.layer_collection.children)
    if children:
        random.choice(children).exclude ^= True


def _unlink_object(random: Random, folder: Path) -> None:
    for item in random.sample(_objects(), min(1, len(_objects()))):
        for collection in item.users_collection:
            collection.objects.unlink(item)


def _duplicate(random: Random, folder: Path) -> None:
    bpy.ops.object.duplicate(linked=random.random() < 0.5)


def _select(random: Random, folder: Path) -> None:
    campaign_scenes.select_some(random)


def _set_frame(random: Random, folder: Path) -> None:
    for item in bpy.data.cameras:
        for owner in _objects():
            if owner.data == item:
                owner.location = [random.uniform(-100.0, 100.0) for _ in range(3)]
    bpy.context.scene.frame_set(random.randrange(250))


def _undo(random: Random, folder: Path) -> None:
    bpy.ops.ed.undo()


def _redo(random: Random, folder: Path) -> None:
    bpy.ops.ed.redo()


def _push_undo(random: Random, folder: Path) -> None:
    bpy.ops.ed.undo_push(message="Campaign")


def _save_and_open(random: Random, folder: Path) -> None:
    path = str(folder / "session.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, check_existing=False)
    bpy.ops.wm.open_mainfile(filepath=path)


def _change_mode(random: Random, folder: Path) -> None:
    with suppress(TypeError):  # the active object has no such mode
        bpy.ops.object.mode_set(mode=random.choice(("OBJECT", "EDIT", "SCULPT", "OBJECT")))


def _edit_mesh(random: Random, folder: Path) -> None:
    for mesh in random.sample(list(bpy.data.meshes), min(1, len(bpy.data.meshes))):
        if mesh.vertices and not mesh.is_editmode:
            mesh.vertices[random.randrange(len(mesh.vertices))].co.x = random.choice((5.0, math.nan, 1e30))
            mesh.update()


def _add_scene(random: Random, folder: Path) -> None:
    bpy.ops.scene.new(type=random.choice(("NEW", "LINK_COPY", "FULL_COPY")))


def _set_camera(random: Random, folder: Path) -> None:
    bpy.context.scene.camera = random.choice([*_objects(), None])


ACTIONS = (
    _change_object, _change_object, _remove_object, _remove_data, _rename_data, _exchange_names, _corrupt_property, _corrupt_property,
    _exclude_collection, _unlink_object, _duplicate, _select, _select, _set_frame, _undo, _redo, _push_undo, _save_and_open, _change_mode,
    _edit_mesh, _add_scene, _set_camera,
)  # fmt: skip
