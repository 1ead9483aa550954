"""A terrain follows a viewer: a thread works out what changes, and the main thread shows it, a few milliseconds at a time."""

import sys
import time
from queue import Empty
from typing import Any

import bpy
import numpy as np

from ..bridge import terrain_objects
from ..bridge.terrain_objects import HiddenMeshes, StandingTerrain
from ..core.clipbox.terrain import Update
from ..core.errors import FarfieldError
from ..core.progress import finish
from ..core.worker import Worker
from . import clipbox_engines

BUDGET = 0.008  # seconds of the main thread that a tick may take

followings: list["Following"] = []  # those that go on


class Following:
    """Lets one terrain follow. Its thread owns the voxels; the main thread fills hidden meshes with surfaces, and swaps all at once.

    moves: how many were shown. longest_slice: seconds that the longest tick took.
    """

    def __init__(self, standing: StandingTerrain) -> None:
        self.standing = standing
        self.moves = 0
        self.longest_slice = 0.0
        self._engine = clipbox_engines.engine_of(standing)
        self._worker: Worker[Update] | None = None
        self._hidden: HiddenMeshes | None = None
        followings.append(self)

    def settled(self, viewer: np.ndarray) -> bool:
        """Whether what is shown lies about `viewer` (3,), and nothing is under way."""
        return self._worker is None and self._engine.lies_about(viewer)

    def tick(self, viewer: np.ndarray, budget: float = BUDGET) -> bool:
        """Go on for at most `budget` seconds towards boxes about `viewer` (3,), a place in the terrain; whether a move was shown.

        Raises:
            FarfieldError: when the terrain has gone, or its function fails. What is shown stays.
        """
        started = time.perf_counter()
        try:
            return self._advance(viewer, started, budget)
        finally:
            self.longest_slice = max(self.longest_slice, time.perf_counter() - started)

    def pause(self) -> None:
        """Stop the thread; what it was making is made by the next move, so that voxels may be used from elsewhere."""
        if self._worker is not None:
            self._worker.stop()
            self._worker.wait()
            self._worker = None
            self._engine.forget()

    def close(self) -> None:
        """Follow no more."""
        self.pause()
        if self in followings:
            followings.remove(self)

    def _advance(self, viewer: np.ndarray, started: float, budget: float) -> bool:
        if self._worker is None:
            if not self._engine.lies_about(viewer):
                self._worker = Worker(self._engine.move(viewer))
                self._hidden = HiddenMeshes(self.standing.origin, self._engine.settings)
            return False
        done, longest = self._worker.done, 0.0
        while (now := time.perf_counter()) - started + longest < budget:
            try:
                key, block = self._engine.finished.get_nowait()
            except Empty:
                break
            self._hidden.fill(key, block)
            longest = max(longest, time.perf_counter() - now)
        if not done or not self._engine.finished.empty() or time.perf_counter() - started > 0.5 * budget:
            return False  # what is left fits the next tick better
        worker, self._worker = self._worker, None
        update = worker.result()
        terrain_objects.put_in_place(self.standing, self._hidden.names, update, self.standing.material)
        self.moves += 1
        return True


def follow_at_once(standing: StandingTerrain, viewer: np.ndarray) -> None:
    """Let a terrain lie about `viewer` (3,) before going on; nothing is done where it does."""
    if clipbox_engines.is_shown_about(standing, viewer):
        return
    for following in followings:
        if following.standing == standing:
            following.pause()
    engine = clipbox_engines.engine_of(standing)
    update = finish(engine.move(viewer))
    meshes = finish(terrain_objects.filled(update, standing.origin, engine.settings))
    terrain_objects.put_in_place(standing, meshes, update, standing.material)


@bpy.app.handlers.persistent
def follow_camera(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Let the terrains that follow the scene's camera do so in a new frame, also while an animation renders."""
    if scene.camera is None:
        return
    camera = scene.camera if depsgraph is None else scene.camera.evaluated_get(depsgraph)
    for standing in terrain_objects.standing_terrains(scene):
        if standing.root.farfield_clipbox_follow:
            try:
                follow_at_once(standing, standing.seen_from(camera.matrix_world))
            except FarfieldError as error:
                print(error, file=sys.stderr)


@bpy.app.handlers.persistent
def _start_over(*_: Any) -> None:
    """After undo and redo nobody knows what is shown."""
    for following in followings:
        following.pause()
    clipbox_engines.forget_shown()


@bpy.app.handlers.persistent
def _let_go(*_: Any) -> None:
    """Another file is opened."""
    for following in list(followings):
        following.close()
    clipbox_engines.forget_all()


def _lock_window(_item: bpy.types.Object, context: bpy.types.Context) -> None:
    """Meshes that change while frames render must not be drawn meanwhile."""
    context.scene.render.use_lock_interface = True


HANDLERS: tuple[tuple[str, Any], ...] = (
    ("frame_change_post", follow_camera),
    ("undo_post", _start_over),
    ("redo_post", _start_over),
    ("load_pre", _let_go),
)


def register() -> None:
    """Follow frames, undo, and the opening of files."""
    bpy.types.Object.farfield_clipbox_follow = bpy.props.BoolProperty(
        name="Follow Camera",
        description="Let this terrain lie about the scene's camera in every frame, also while an animation renders",
        update=_lock_window,
    )
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """The reverse."""
    _let_go()
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
    del bpy.types.Object.farfield_clipbox_follow
