"""Terrains that follow a viewer: a thread computes the changes, and the main thread shows them, a few milliseconds at a time."""

import sys
import time
from queue import Empty
from typing import Any

import bpy
import numpy as np

from ...bridge.clipbox import objects as terrain_objects
from ...bridge.clipbox.objects import PendingMeshes, SceneTerrain
from ...core.clipbox.engine import TerrainEngine, Update
from ...core.errors import FarfieldError
from ...core.jobs.background_thread import BackgroundThread
from ...core.jobs.progress import run_to_end
from . import engines

MAX_TICK_SECONDS = 0.008  # of the main thread


class Following:
    """Lets one terrain follow a viewer. Its thread owns the voxels; the main thread fills pending meshes and shows all of them at once.

    moves: number of moves that were shown. longest_tick: seconds of the main thread.
    """

    def __init__(self, terrain: SceneTerrain) -> None:
        self.terrain = terrain
        self.moves = 0
        self.longest_tick = 0.0
        self._engine = engines.cache.get(terrain)
        self._thread: BackgroundThread[Update] | None = None
        self._pending: PendingMeshes | None = None
        _running.append(self)

    def is_settled(self, viewer: np.ndarray) -> bool:
        """Return whether the terrain is centered on `viewer` (3,), and no move is running."""
        return self._thread is None and self._engine.is_centered_on(viewer)

    def tick(self, viewer: np.ndarray, max_seconds: float = MAX_TICK_SECONDS) -> bool:
        """Continue for at most `max_seconds` to center the terrain on `viewer` (3,), a terrain position. Returns whether a move was shown.

        Raises:
            FarfieldError: the terrain was removed, or its density function failed. The scene is unchanged.
        """
        started = time.perf_counter()
        try:
            return self._advance(viewer, started, max_seconds)
        finally:
            self.longest_tick = max(self.longest_tick, time.perf_counter() - started)

    def pause(self) -> None:
        """Stop the thread, so that the voxels can be used elsewhere. The next move repeats the cancelled one."""
        if self._thread is not None:
            self._thread.cancel()
            self._thread.wait()
            self._thread = None
            self._engine.invalidate()

    def close(self) -> None:
        """Stop following."""
        self.pause()
        if self in _running:
            _running.remove(self)

    def _advance(self, viewer: np.ndarray, started: float, max_seconds: float) -> bool:
        if self._thread is None:
            if not self._engine.is_centered_on(viewer):
                self._thread = BackgroundThread(self._engine.move(viewer))
                self._pending = PendingMeshes(self.terrain.origin, self._engine.settings)
            return False
        is_done, longest_fill = self._thread.is_done, 0.0
        while (now := time.perf_counter()) - started + longest_fill < max_seconds:
            try:
                key, block = self._engine.finished_blocks.get_nowait()
            except Empty:
                break
            self._pending.fill(key, block)
            longest_fill = max(longest_fill, time.perf_counter() - now)
        if not is_done or not self._engine.finished_blocks.empty() or time.perf_counter() - started > 0.5 * max_seconds:
            return False  # showing the meshes fits the next tick better
        thread, self._thread = self._thread, None
        update = thread.result()
        terrain_objects.show_meshes(self.terrain, self._pending.names, update, self.terrain.material)
        self.moves += 1
        return True


_running: list[Following] = []


def running() -> tuple[Following, ...]:
    """Return the followings that have not been closed."""
    return tuple(_running)


def close_all() -> None:
    """Close all followings."""
    for following in running():
        following.close()


def recenter(terrain: SceneTerrain, viewer: np.ndarray) -> None:
    """Center a terrain on `viewer` (3,), a terrain position, and wait for the result. Does nothing where it is already centered."""
    if TerrainEngine.has_same_layout(terrain.settings, terrain.viewer, viewer):
        return
    for following in running():
        if following.terrain == terrain:
            following.pause()
    engine = engines.cache.get(terrain)
    update = run_to_end(engine.move(viewer))
    mesh_names = run_to_end(terrain_objects.fill_meshes(update, terrain.origin, engine.settings))
    terrain_objects.show_meshes(terrain, mesh_names, update, terrain.material)


@bpy.app.handlers.persistent
def follow_active_camera(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Recenter the terrains that follow the active camera in a new frame, also while an animation renders."""
    if scene.camera is None:
        return
    camera = scene.camera if depsgraph is None else scene.camera.evaluated_get(depsgraph)
    for terrain in terrain_objects.scene_terrains(scene):
        if terrain.root.farfield_clipbox_follow_camera:
            try:
                recenter(terrain, terrain.viewer_position(camera.matrix_world))
            except FarfieldError as error:
                print(error, file=sys.stderr)


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    """After undo and redo it is unknown which blocks are shown."""
    for following in running():
        following.pause()
    engines.cache.invalidate()


@bpy.app.handlers.persistent
def _after_change(*_: Any) -> None:
    """Objects may have been deleted or renamed."""
    engines.cache.evict_missing()


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    """Another file is about to be opened."""
    close_all()
    engines.cache.clear()


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
        getattr(bpy.app.handlers, name).remove(handler)
    del bpy.types.Object.farfield_clipbox_follow_camera
