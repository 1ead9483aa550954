"""A terrain follows a viewer: a thread works out what changes, and the main thread shows it, a few milliseconds at a time."""

import sys
import time
from typing import Any

import bpy
import numpy as np

from ..bridge import terrain_objects
from ..bridge.terrain_objects import StandingTerrain
from ..core.clipbox.terrain import Update
from ..core.errors import FarfieldError
from ..core.progress import Steps, finish
from ..core.worker import Worker
from . import clipbox_engines

BUDGET = 0.008  # seconds of the main thread that a tick may take


class Following:
    """Lets one terrain follow. The thread owns the voxels; the main thread gets finished meshes, fills spare ones and swaps them at once.

    moves: how many were shown. longest_slice: seconds that the longest tick took.
    """

    def __init__(self, standing: StandingTerrain) -> None:
        self.standing = standing
        self.moves = 0
        self.longest_slice = 0.0
        self._worker: Worker[Update] | None = None
        self._update: Update | None = None
        self._filling: Steps[dict] | None = None

    @property
    def busy(self) -> bool:
        """Whether a move is under way."""
        return self._worker is not None or self._filling is not None

    def tick(self, viewer: np.ndarray, budget: float = BUDGET) -> bool:
        """Go on for at most `budget` seconds towards boxes about `viewer` (3,), a place in the terrain; whether a move was shown.

        Raises:
            FarfieldError: when the terrain has gone, or its function fails. What is shown stays.
        """
        started = time.perf_counter()
        try:
            return self._advance(viewer, started + budget)
        finally:
            self.longest_slice = max(self.longest_slice, time.perf_counter() - started)

    def close(self) -> None:
        """Stop the thread and let go of what it was making."""
        if self._worker is not None:
            self._worker.stop()
            self._worker.wait()
            self._worker = None
        if self._filling is not None:
            self._filling.close()
            self._filling = None
            clipbox_engines.engine_of(self.standing).forget()

    def _advance(self, viewer: np.ndarray, until: float) -> bool:
        engine = clipbox_engines.engine_of(self.standing)
        if not self.busy and not engine.lies_about(viewer):
            self._worker = Worker(engine.move(viewer))
        if self._worker is not None and self._worker.done:
            worker, self._worker = self._worker, None
            self._update = worker.result()
            self._filling = terrain_objects.filled(self._update, self.standing.origin, engine.settings)
        while self._filling is not None and time.perf_counter() < until:
            try:
                next(self._filling)
            except StopIteration as finished:
                self._filling = None
                terrain_objects.put_in_place(self.standing, finished.value, self._update, self.standing.material)
                self.moves += 1
                return True
        return False


def follow_at_once(standing: StandingTerrain, viewer: np.ndarray) -> None:
    """Let a terrain lie about `viewer` (3,) before going on; nothing is done where it does."""
    if clipbox_engines.is_shown_about(standing, viewer):
        return
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


HANDLERS: tuple[tuple[str, Any], ...] = (("frame_change_post", follow_camera),)


def register() -> None:
    """Follow frames."""
    bpy.types.Object.farfield_clipbox_follow = bpy.props.BoolProperty(
        name="Follow Camera", description="Let this terrain lie about the scene's camera in every frame, also while an animation renders"
    )
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """The reverse."""
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
    del bpy.types.Object.farfield_clipbox_follow
