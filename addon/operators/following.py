"""Terrains that follow a viewer: a thread computes the changes, and the main thread shows them, a few milliseconds at a time."""

import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from queue import Empty
from typing import Any

import bpy
import numpy as np

from ..bridge.terrain_roots import TerrainRoot
from ..core.errors import Cancelled, GeometryError
from ..core.jobs.progress import BackgroundThread, Steps, run_to_end
from . import follow_tools, long_work
from .engine_cache import cache, discard_finished_blocks
from .follow_tools import Engine, PrefetchingEngine, QuickEngine

MAX_TICK_SECONDS = 0.008  # Time of the main thread per tick.
SPEED_SECONDS = 0.4  # Time over which the speed of a viewer is measured.


class Following:
    """Lets one terrain follow a viewer. Its thread owns the engine; the main thread fills pending meshes and shows all of them at once.

    moves: number of moves that were shown. longest_tick: seconds of the main thread. longest_evaluation: seconds that Blender then took to
    update the scene for what was shown, without drawing. is_complete: whether nothing is left out of what is shown for a fast viewer.
    """

    def __init__(self, terrain: TerrainRoot) -> None:
        """Start to follow.

        Raises:
            FarfieldError: the terrain is linked, or its settings or files cannot be read.
        """
        _check_editable(terrain)
        self.terrain = terrain
        self.moves = 0
        self.longest_tick = self.longest_evaluation = 0.0
        self.is_complete = True
        self._path = ViewerPath()
        self._move_seconds = 0.0  # From the start of the last complete move until it was shown.
        self._engine = cache.get(terrain)
        self._move: _Move | None = None
        self._prefetch: BackgroundThread[None] | None = None  # between a move and the next one
        self._awaits_evaluation = False
        _running.append(self)

    def is_settled(self, viewer: Any) -> bool:
        """Return whether the terrain shows what is right for `viewer`, as its engine takes it, and no move is running."""
        return self._move is None and self._engine.is_settled_at(viewer)

    def tick(self, viewer: Any, max_seconds: float = MAX_TICK_SECONDS) -> bool:
        """Continue for at most `max_seconds` to follow `viewer`, as the engine takes it. Returns whether a move was shown.

        Raises:
            FarfieldError: the terrain was removed, or the engine failed. The scene is unchanged.
        """
        started = time.perf_counter()
        if isinstance(self._engine, QuickEngine):
            self._path.append(started, viewer)
        try:
            return self._advance(viewer, started, max_seconds)
        finally:
            self.longest_tick = max(self.longest_tick, time.perf_counter() - started)

    def pause(self) -> None:
        """Stop the thread, so that the engine can be used elsewhere. The next move repeats the cancelled one."""
        if self._prefetch is not None:
            self._prefetch.cancel()
            self._prefetch.wait()
            self._prefetch = None
        if self._move is not None:
            self._move.cancel()
            self._move = None
            self._engine.invalidate()

    def complete(self) -> None:
        """Show what is left out for a fast viewer, and wait for that.

        Raises:
            FarfieldError: the terrain was removed, or its engine failed.
        """
        if not self.is_complete:
            recenter(self.terrain, self._path.last)
            self.is_complete = True

    def close(self) -> None:
        """Stop following."""
        self.pause()
        if self in _running:
            _running.remove(self)

    def record_evaluation(self, seconds: float) -> None:
        """Take note that Blender has updated the scene in `seconds`. Counts if a move was shown since the last time."""
        if self._awaits_evaluation:
            self._awaits_evaluation = False
            self.longest_evaluation = max(self.longest_evaluation, seconds)

    def _advance(self, viewer: Any, started: float, max_seconds: float) -> bool:
        if self._move is None:
            if not self._engine.is_settled_at(viewer):
                travel = self._path.speed * 2.0 * self._move_seconds  # Until the next move after this one is shown.
                self._move, self._prefetch = _Move(self.terrain, self._engine, viewer, self._prefetch, travel), None
            return False
        is_valid = False
        try:
            is_shown = self._move.advance(started, max_seconds)
            is_valid = True
        finally:
            if not is_valid:
                self.pause()
        if is_shown:
            self.is_complete = not self._move.leaves_out_detail
            if self.is_complete:
                self._move_seconds = time.perf_counter() - self._move.started
            self._move, self._awaits_evaluation = None, True
            self.moves += 1
            if isinstance(self._engine, PrefetchingEngine):
                self._prefetch = BackgroundThread(self._engine.prefetch())
        return is_shown


class ViewerPath:
    """Where a viewer was in the last moments."""

    def __init__(self) -> None:
        self._positions: deque[tuple[float, np.ndarray]] = deque()

    def append(self, seconds: float, position: np.ndarray) -> None:
        """Add the `position` (3,) at a time, and forget those of earlier times except for the last one."""
        self._positions.append((seconds, position))
        while len(self._positions) > 2 and self._positions[1][0] < seconds - SPEED_SECONDS:
            self._positions.popleft()

    @property
    def last(self) -> np.ndarray:
        """The last position (3,)."""
        return self._positions[-1][1]

    @property
    def speed(self) -> float:
        """The mean speed of these moments without the longest of their steps, which may be a jump. Units per second."""
        if len(self._positions) < 3:
            return 0.0
        times, positions = (np.array(values) for values in zip(*self._positions, strict=True))
        lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        return float(lengths.sum() - lengths.max()) / max(times[-1] - times[0], MAX_TICK_SECONDS)


class _Move:
    """A move whose update is computed in a thread, and its change in the main thread.

    started: the time of its start. leaves_out_detail: whether it does not show all that is right for the viewer.
    """

    def __init__(
        self, terrain: TerrainRoot, engine: Engine, viewer: Any, prefetch: BackgroundThread[None] | None, travel: float = 0.0
    ) -> None:
        """prefetch: a thread that uses the engine, which is cancelled. travel: how far the viewer goes until the next move is shown."""
        self.started, self.leaves_out_detail = time.perf_counter(), False
        self._engine, self._viewer = engine, viewer
        self._change = follow_tools.tool_of(terrain).start_change(terrain, engine)
        self._filling: Iterator[None] | None = None
        self._showing: Iterator[None] | None = None
        discard_finished_blocks(engine)  # They belong to a move that was shown in another way.
        if prefetch is not None:
            prefetch.cancel()
        self._is_quick = travel > 0.0 and isinstance(engine, QuickEngine)
        steps = engine.move_quickly(viewer, travel) if self._is_quick else engine.move(viewer)
        self._thread = BackgroundThread(_move_after(prefetch, steps))

    def advance(self, started: float, max_seconds: float) -> bool:
        """Fill meshes, then show them, until `max_seconds` after `started`. Returns whether they are shown."""
        is_done, longest_step = self._thread.is_done, 0.0  # in this order: a thread that is done adds no more blocks
        while (now := time.perf_counter()) - started + longest_step < max_seconds:
            if self._showing is None and not self._fill():
                if not is_done or now - started > 0.5 * max_seconds:
                    return False  # showing the meshes fits the next tick better
                self._showing = iter(self._change.show(self._thread.result()))
            if self._showing is not None and next(self._showing, self) is self:
                self.leaves_out_detail = self._is_quick and not self._engine.is_settled_at(self._viewer)
                return True
            longest_step = max(longest_step, time.perf_counter() - now)
        return False

    def cancel(self) -> None:
        """Stop the thread and forget the change."""
        self._thread.cancel()
        self._thread.wait()

    def _fill(self) -> bool:
        """Take one step to fill meshes. Returns whether there was one to fill."""
        if self._filling is None:
            try:
                key, block = self._engine.finished_blocks.get_nowait()
            except Empty:
                return False
            self._filling = iter(self._change.fill(key, block))
        if next(self._filling, self) is self:  # it yields None
            self._filling = None
        return True


def _move_after(prefetch: BackgroundThread[None] | None, move: Steps[Any]) -> Steps[Any]:
    """Run a move once a cancelled thread has ended, without blocking the main thread. Raises the error of that thread, if there is one."""
    if prefetch is not None:
        with suppress(Cancelled):
            prefetch.result()
    return (yield from move)


_running: list[Following] = []


def running() -> tuple[Following, ...]:
    """Return the followings that have not been closed."""
    return tuple(_running)


def close_all(tool: str = "") -> None:
    """Close all followings, or those of a tool."""
    for following in running():
        if tool in ("", following.terrain.tool):
            following.close()


def recenter(terrain: TerrainRoot, viewer: Any) -> None:
    """Show what is right for `viewer`, as the terrain's engine takes it, and wait for that. Does nothing if it is already shown.

    Raises:
        FarfieldError: the terrain is linked, its settings or files cannot be read, or its engine failed.
    """
    _check_editable(terrain)
    tool = follow_tools.tool_of(terrain)
    if tool.is_shown_at(terrain, viewer):
        return
    for following in running():
        if following.terrain == terrain:
            following.pause()
    engine = cache.get(terrain)
    change = tool.start_change(terrain, engine)
    is_valid = False
    try:
        update = run_to_end(engine.move(viewer))
        while not engine.finished_blocks.empty():
            _run(change.fill(*engine.finished_blocks.get_nowait()))
        _run(change.show(update))
        is_valid = True
    finally:
        if not is_valid:
            engine.invalidate()


def _run(steps: Iterable[None]) -> None:
    for _ in steps:
        pass


def _check_editable(terrain: TerrainRoot) -> None:
    if terrain.read_only_reason:
        raise GeometryError(f"{terrain.read_only_reason}.")


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why no terrain can be created or changed now, or an empty string."""
    if context.mode != "OBJECT":
        return "Switch to Object Mode"
    if not context.scene.is_editable:
        return "The scene is linked from another file"
    is_following = bool(running())
    return long_work.running_job_message() or ("A terrain is following the view; press Stop Following first" if is_following else "")
