"""What terrains do when the frame changes, after undo and redo, and before another file is opened, for all tools whose terrains follow."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from ..bridge import viewers
from ..bridge.geometry.mesh_pool import spare_meshes
from ..bridge.terrain_roots import TerrainRoot
from . import follow_tools, following, view_following
from .engine_cache import cache
from .error_reports import describe_error
from .follow_tools import FollowTool


class _FileState:
    """What the handlers keep until another file is opened.

    cleared: terrains whose meshes were removed before undo. printed: errors. update_started: of Blender's last update of the scene.
    """

    def __init__(self) -> None:
        self.cleared: list[TerrainRoot] = []
        self.printed: set[str] = set()
        self.update_started = 0.0


_state = _FileState()


@bpy.app.handlers.persistent
def follow_active_camera(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Recenter the terrains that follow the active camera in a new frame, also while an animation renders."""
    if scene.camera is None:
        return
    camera = scene.camera if depsgraph is None else scene.camera.evaluated_get(depsgraph)
    for tool in follow_tools.registered.values():
        for terrain in tool.scene_terrains(scene):
            if follows_camera(terrain):
                try:
                    following.recenter(terrain, tool.to_terrain(terrain, viewers.camera_viewer(scene, camera)))
                except Exception as error:  # noqa: BLE001 catch-all: nobody else catches the errors of a handler
                    _print_once(error)


def _print_once(error: Exception) -> None:
    """Print the sentence about an error on stderr, once per file: an animation has many frames."""
    key = f"{type(error).__name__}: {error}"
    if key not in _state.printed:
        _state.printed.add(key)
        print(describe_error(error, "Follow Active Camera"), file=sys.stderr)


@bpy.app.handlers.persistent
def _before_undo(*_: Any) -> None:
    """Remove what moves may have changed since the last undo step.

    Undo keeps data-blocks that are equal in two undo steps as they are now. A collection with objects that a move has created since then,
    or an object with such a mesh, would refer to data that undo frees, and Blender would crash. What is removed here is read again.
    """
    for item in following.running():
        item.pause()
    _state.cleared.clear()
    if bpy.context.mode != "OBJECT":
        return  # other modes have undo steps of their own
    for terrain in _local_terrains():
        if terrain in cache:
            terrain.remove_shown()
            bpy.data.batch_remove(spare_meshes(terrain.tool))
            _state.cleared.append(terrain)


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    """After undo and redo it is unknown what is shown."""
    for item in following.running():
        item.pause()
    cache.invalidate()
    for terrain in _local_terrains():
        terrain.link_shown()
        if terrain in _state.cleared and not terrain.shown_objects():
            _show_again(terrain)  # there was nothing to undo
    _state.cleared.clear()


def _local_terrains() -> list[TerrainRoot]:
    """Return the terrains of all scenes that belong to this file."""
    terrains = [terrain for tool in follow_tools.registered.values() for scene in bpy.data.scenes for terrain in tool.scene_terrains(scene)]
    return [terrain for terrain in dict.fromkeys(terrains) if not terrain.read_only_reason]


def _show_again(terrain: TerrainRoot) -> None:
    """Show a terrain for the active camera, or the first 3D Viewport."""
    viewer = view_following.view_of_area(bpy.context.scene, view_following.context_viewport(bpy.context))
    try:
        following.recenter(terrain, follow_tools.tool_of(terrain).to_terrain(terrain, viewer))
    except Exception as error:  # noqa: BLE001 catch-all: nobody else catches the errors of a handler
        _print_once(error)


@bpy.app.handlers.persistent
def _before_change(*_: Any) -> None:
    """Blender is about to update the scene."""
    _state.update_started = time.perf_counter()


@bpy.app.handlers.persistent
def _after_change(*_: Any) -> None:
    """Objects may have been deleted or renamed."""
    for item in following.running():
        item.record_evaluation(time.perf_counter() - _state.update_started)
    cache.evict_missing()


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    """Another file is about to be opened."""
    view_following.current.stop()
    following.close_all()
    cache.clear()
    _state.printed.clear()


def _lock_interface(_item: bpy.types.Object, context: bpy.types.Context) -> None:
    """Meshes that change while frames render must not be drawn meanwhile."""
    context.scene.render.use_lock_interface = True


HANDLERS: tuple[tuple[str, Any], ...] = (
    ("frame_change_post", follow_active_camera),
    ("undo_pre", _before_undo),
    ("redo_pre", _before_undo),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
    ("depsgraph_update_pre", _before_change),
    ("depsgraph_update_post", _after_change),
    ("load_pre", _before_load),
)


def camera_property(tool: str) -> str:
    """Return the name of the property *Follow Active Camera* of the roots of a tool's terrains."""
    return f"farfield_{tool}_follow_camera"


def follows_camera(terrain: TerrainRoot) -> bool:
    """Return whether a terrain follows the active camera."""
    return getattr(terrain.root, camera_property(terrain.tool))


@contextmanager
def paused_followers(scene: bpy.types.Scene) -> Iterator[None]:
    """Let no terrain of a scene follow the active camera within the context, so that frames change quickly."""
    paused = []
    for tool in follow_tools.registered.values():
        for terrain in tool.scene_terrains(scene):
            if not terrain.read_only_reason and follows_camera(terrain):
                setattr(terrain.root, camera_property(terrain.tool), False)
                paused.append(terrain)
    try:
        yield
    finally:
        for terrain in paused:
            if terrain.root is not None:
                setattr(terrain.root, camera_property(terrain.tool), True)


def register_tool(tool: FollowTool) -> None:
    """Let the terrains of a tool follow, and register their property *Follow Active Camera*."""
    follow_tools.registered[tool.identifier] = tool
    follow_camera = bpy.props.BoolProperty(
        name="Follow Active Camera",
        description="Center this terrain on the active camera in every frame, also while an animation renders",
        update=_lock_interface,
    )
    setattr(bpy.types.Object, camera_property(tool.identifier), follow_camera)


def unregister_tool(tool: FollowTool) -> None:
    """Close the followings of a tool's terrains, remove their engines and unregister the property."""
    if view_following.current.terrain is not None and view_following.current.terrain.tool == tool.identifier:
        view_following.current.stop()
    following.close_all(tool.identifier)
    cache.clear(tool.identifier)
    follow_tools.registered.pop(tool.identifier, None)
    delattr(bpy.types.Object, camera_property(tool.identifier))


def register() -> None:
    """Register the handlers."""
    add_handlers(HANDLERS)


def unregister() -> None:
    """Close all followings and unregister the handlers."""
    _before_load()
    remove_handlers(HANDLERS)


Handlers = Iterable[tuple[str, Callable[..., Any]]]  # names of lists of handlers, and functions to be called


def add_handlers(handlers: Handlers) -> None:
    """Let Blender call `handlers`."""
    for name, handler in handlers:
        getattr(bpy.app.handlers, name).append(handler)


def remove_handlers(handlers: Handlers) -> None:
    """Undo `add_handlers`."""
    for name, handler in handlers:
        registered = getattr(bpy.app.handlers, name)
        if handler in registered:  # another add-on may have cleared the list
            registered.remove(handler)
