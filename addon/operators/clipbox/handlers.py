"""What terrains do when the frame changes, after undo and redo, and before another file is opened."""

import sys
from typing import Any

import bpy

from ...bridge.clipbox import objects as terrain_objects
from ..error_reports import describe_error
from . import engines, following, view_following

_printed: set[str] = set()  # errors since the file was opened


@bpy.app.handlers.persistent
def follow_active_camera(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Recenter the terrains that follow the active camera in a new frame, also while an animation renders."""
    if scene.camera is None:
        return
    camera = scene.camera if depsgraph is None else scene.camera.evaluated_get(depsgraph)
    for terrain in terrain_objects.scene_terrains(scene):
        if terrain.root.farfield_clipbox_follow_camera:
            try:
                following.recenter(terrain, terrain.viewer_position(camera.matrix_world))
            except Exception as error:  # noqa: BLE001 the last resort: nobody else catches the errors of a handler
                _print_once(error)


def _print_once(error: Exception) -> None:
    """Print the sentence about an error on stderr, once per file: an animation has many frames."""
    key = f"{type(error).__name__}: {error}"
    if key not in _printed:
        _printed.add(key)
        print(describe_error(error, "Follow Active Camera"), file=sys.stderr)


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    """After undo and redo it is unknown which blocks are shown."""
    for item in following.running():
        item.pause()
    engines.cache.invalidate()


@bpy.app.handlers.persistent
def _after_change(*_: Any) -> None:
    """Objects may have been deleted or renamed."""
    engines.cache.evict_missing()


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    """Another file is about to be opened."""
    view_following.current.stop()
    following.close_all()
    engines.cache.clear()
    _printed.clear()


def _lock_interface(_item: bpy.types.Object, context: bpy.types.Context) -> None:
    """Meshes that change while frames render must not be drawn meanwhile."""
    context.scene.render.use_lock_interface = True


HANDLERS: tuple[tuple[str, Any], ...] = (
    ("frame_change_post", follow_active_camera),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
    ("depsgraph_update_post", _after_change),
    ("load_pre", _before_load),
)


def register() -> None:
    """Register the property *Follow Active Camera* and the handlers."""
    bpy.types.Object.farfield_clipbox_follow_camera = bpy.props.BoolProperty(
        name="Follow Active Camera",
        description="Center this terrain on the active camera in every frame, also while an animation renders",
        update=_lock_interface,
    )
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Close all followings and unregister the handlers and the property."""
    _before_load()
    for name, handler in HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:  # another add-on may have cleared the list
            handlers.remove(handler)
    del bpy.types.Object.farfield_clipbox_follow_camera
