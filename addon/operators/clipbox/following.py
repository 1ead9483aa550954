"""Terrains that follow a viewer: a thread computes the changes, and the main thread shows them, a few milliseconds at a time."""

import time
from queue import Empty

import numpy as np

from ...bridge.clipbox import objects as terrain_objects
from ...bridge.clipbox.objects import PendingMeshes, SceneTerrain
from ...core.clipbox.engine import TerrainEngine, Update
from ...core.errors import GeometryError
from ...core.jobs.background_thread import BackgroundThread
from ...core.jobs.progress import run_to_end
from . import engines

MAX_TICK_SECONDS = 0.008  # of the main thread


class Following:
    """Lets one terrain follow a viewer. Its thread owns the voxels; the main thread fills pending meshes and shows all of them at once.

    moves: number of moves that were shown. longest_tick: seconds of the main thread.
    """

    def __init__(self, terrain: SceneTerrain) -> None:
        """Start to follow.

        Raises:
            FarfieldError: the terrain is linked, or its settings or source file cannot be read.
        """
        _check_editable(terrain)
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
    """Center a terrain on `viewer` (3,), a terrain position, and wait for the result. Does nothing where it is already centered.

    Raises:
        FarfieldError: the terrain is linked, its settings or source file cannot be read, or its density function failed.
    """
    _check_editable(terrain)
    if TerrainEngine.has_same_layout(terrain.settings, terrain.viewer, viewer):
        return
    for following in running():
        if following.terrain == terrain:
            following.pause()
    engine = engines.cache.get(terrain)
    update = run_to_end(engine.move(viewer))
    mesh_names = run_to_end(terrain_objects.fill_meshes(update, terrain.origin, engine.settings))
    terrain_objects.show_meshes(terrain, mesh_names, update, terrain.material)


def _check_editable(terrain: SceneTerrain) -> None:
    if terrain.read_only_reason:
        raise GeometryError(f"{terrain.read_only_reason}.")
