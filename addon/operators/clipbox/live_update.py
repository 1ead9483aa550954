"""*Live Update*: a terrain is rebuilt in the background whenever its settings or edits have changed (Figure 19 of the paper)."""

import sys
import time
from typing import Any

import bpy

from ...bridge.clipbox.edits import read_edits
from ...bridge.clipbox.objects import SceneTerrain
from ...core.clipbox.engine import Update
from ...core.clipbox.settings import ClipboxSettings
from ...core.clipbox.terrains.edits import NO_EDITS
from ...core.errors import FarfieldError
from ...core.jobs.progress import BackgroundThread, Steps
from ...core.messages import single_line
from .. import following, long_work, properties
from ..error_reports import describe_error, reports_errors
from ..follow_handlers import add_handlers, remove_handlers
from ..following import MAX_TICK_SECONDS
from ..view_following import ActiveTerrainOperator, is_job_running, is_transforming
from .job import TerrainJob, keep_blend_paths, prepare

IDLE_TICK, BUSY_TICK = 0.1, 1.0 / 60.0  # Seconds between two calls of the timer.
PAUSE = 0.3  # Seconds without a change before a build starts, so that dragging a slider does not start many.


class LiveUpdate:
    """The terrain that is rebuilt when its settings change, if there is one. Operators, panels and the timer share one instance.

    error: why the last build failed, an empty string if it did not. has_changed: whether objects may have changed since they were read.
    """

    def __init__(self) -> None:
        self.error, self.has_changed = "", True
        self.terrain: SceneTerrain | None = None
        self._edits = NO_EDITS
        self._shown: Any = None  # Settings and edits of the last build, or of a failed one.
        self._wanted: Any = None  # Those of the scene, and since when.
        self._wanted_since = 0.0
        self._job: TerrainJob | None = None
        self._thread: BackgroundThread[Update] | None = None
        self._showing: Steps[str] | None = None
        self._timer = self._tick  # Blender identifies timers by the object.

    def start(self, terrain: SceneTerrain) -> None:
        """Rebuild `terrain` from now on.

        Raises:
            SettingsError: its settings cannot be read.
        """
        self.stop()
        self.terrain = terrain
        self._edits = read_edits(bpy.context.scene, terrain.settings.edit_blend, terrain)
        self._shown = terrain.settings, self._edits
        bpy.app.timers.register(self._timer, first_interval=IDLE_TICK)

    def stop(self) -> None:
        """Rebuild no terrain."""
        self._cancel()
        self.terrain, self.error = None, ""
        if bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.unregister(self._timer)

    def restart(self) -> None:
        """Rebuild the terrain in any case: undo has brought back an earlier one, and has removed meshes of a running build."""
        self._cancel()
        self._shown = None

    def advance(self) -> None:
        """Continue for a moment: start, continue or cancel a build.

        Raises:
            FarfieldError: the settings are invalid, or the build failed. The scene is unchanged.
        """
        if is_job_running() or is_transforming() or following.running() or bpy.context.mode != "OBJECT":
            self._cancel()
            return
        settings = keep_blend_paths(properties.read(ClipboxSettings, bpy.context.scene.farfield_clipbox))
        if self.has_changed or settings.edit_blend != self._edits.blend:
            self._edits, self.has_changed = read_edits(bpy.context.scene, settings.edit_blend, self.terrain), False
        wanted = settings, self._edits
        if wanted != self._wanted:
            self._cancel()
            self._wanted, self._wanted_since = wanted, time.perf_counter()
        if self._job is not None:
            self._continue()
        elif wanted != self._shown and time.perf_counter() - self._wanted_since > PAUSE:
            self._shown = wanted  # A failed build is not repeated.
            self._job = prepare(settings, self.terrain.viewer, self.terrain)
            self._thread = BackgroundThread(self._job.core_steps())

    def _continue(self) -> None:
        """Show the result once it is computed."""
        if not self._thread.is_done:
            return
        started = time.perf_counter()
        if self._showing is None:
            self._showing = self._job.scene_steps(self._thread.result())
        while time.perf_counter() - started < MAX_TICK_SECONDS:
            if next(self._showing, None) is None:
                self._job = self._thread = self._showing = None
                self.error = ""
                long_work.redraw_sidebars(bpy.context.window_manager)
                return

    def _cancel(self) -> None:
        """Forget the build that is running, so that it starts again."""
        if self._thread is not None:
            self._thread.cancel()
            self._thread.wait()
            self._shown = None
        self._job = self._thread = self._showing = None

    def _tick(self) -> float | None:
        """Continue for a moment; return the seconds to the next call, None to end."""
        try:
            if self.terrain is None or self.terrain.root is None:
                self.stop()
                return None
            self.advance()
        except FarfieldError as error:
            self._fail(single_line(str(error)))
        except Exception as error:  # noqa: BLE001 catch-all: nobody else catches the errors of a timer
            self._fail(single_line(describe_error(error, "Live Update")))
        return IDLE_TICK if self._job is None else BUSY_TICK

    def _fail(self, error: str) -> None:
        """Wait for other settings."""
        shown = self._shown
        self._cancel()
        self._shown, self.error = shown, error
        print(error, file=sys.stderr)
        long_work.redraw_sidebars(bpy.context.window_manager)


current = LiveUpdate()


class FARFIELD_OT_clipbox_live_update(ActiveTerrainOperator, bpy.types.Operator):
    """Rebuild the active terrain in the background whenever its settings or edits change. Press again to stop"""

    bl_idname = "farfield.clipbox_live_update"
    bl_label = "Update Terrain Live"
    bl_options = {"REGISTER"}
    terrain_type = SceneTerrain

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain is updated live, or one that can be is active."""
        return current.terrain is not None or long_work.poll_with_reason(cls, cls.disabled_reason(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start, or stop."""
        if current.terrain is None:
            current.start(self.active_terrain(context))
        else:
            current.stop()
        long_work.redraw_sidebars(context.window_manager)
        return {"FINISHED"}


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    """Another file is about to be opened."""
    current.stop()


@bpy.app.handlers.persistent
def _after_change(*_: Any) -> None:
    """Objects may have been moved."""
    current.has_changed = True


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    """Data-blocks have the state of another time."""
    current.has_changed = True
    current.restart()


HANDLERS: tuple[tuple[str, Any], ...] = (
    ("load_pre", _before_load),
    ("depsgraph_update_post", _after_change),
    ("undo_post", _after_undo),
    ("redo_post", _after_undo),
)
register_classes, unregister_classes = bpy.utils.register_classes_factory((FARFIELD_OT_clipbox_live_update,))


def register() -> None:
    """Register the operator and the handler."""
    register_classes()
    add_handlers(HANDLERS)


def unregister() -> None:
    """Stop, and undo `register`."""
    current.stop()
    remove_handlers(HANDLERS)
    unregister_classes()
