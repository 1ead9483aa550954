"""Long work in operators: blocking in scripts; in the background with progress bar, time left and Esc in the interface.

A timer watches the first half of a job, which runs in a thread, so that Blender continues to autosave: it does not while a modal
operator runs. The second half uses the scene. It belongs to a modal operator that keeps the user from changing the scene meanwhile.
"""

from collections.abc import Callable
from typing import Any

import bpy

from ..core.jobs.progress import NOTHING_CHANGED, run_to_end
from .error_reports import report_error, report_message, reports_errors
from .job_run import TICK, Job, Run, run_job, status_text
from .results import report_result, store_result, tool_of

_current: Run | None = None  # operators, panels, timers and load handlers of Blender share the one running job
_shown_status = ""
_keymap_items: list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]] = []


def current_run() -> Run | None:
    """Return the running job, if there is one."""
    return _current


def running_job_message() -> str:
    """Return why no other job can be started now, or an empty string."""
    return "" if _current is None else f"{_current.title} is still running"


def poll_with_reason(operator: type[bpy.types.Operator], reason: str) -> bool:
    """Return the result of an operator's `poll`: False if there is a `reason` against it, which Blender then shows."""
    if reason:
        operator.poll_message_set(reason)
    return not reason


def redraw_sidebars(window_manager: bpy.types.WindowManager) -> None:
    """Redraw the sidebars of all 3D Viewports and Image Editors."""
    for window in window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type in {"VIEW_3D", "IMAGE_EDITOR"} else ():
                if region.type == "UI":
                    region.tag_redraw()


class LongWork:
    """Mixin of operators that run a `Job`. The operator implements `prepare`; the mixin implements execute and invoke."""

    def prepare(self, context: bpy.types.Context) -> Job:
        """Read everything that the job needs from Blender, or raise FarfieldError."""
        raise NotImplementedError

    def prepare_follow_up(self, _context: bpy.types.Context) -> Callable[[], None]:
        """Return a function that is called after the undo step of a run in the interface, not in scripts: undo does not undo its changes.
        By default, it does nothing."""
        return lambda: None

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Run the job to the end, blocking."""
        if not self._check_no_job_runs():
            return {"CANCELLED"}
        window_manager = context.window_manager
        window_manager.progress_begin(0.0, 1.0)
        try:
            message = run_to_end(run_job(self.prepare(context)), lambda step: window_manager.progress_update(step.fraction))
        finally:
            window_manager.progress_end()
        store_result(context.scene, tool_of(type(self).bl_idname), message)
        report_message(self, message)
        return {"FINISHED"}

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the job in the background and return immediately."""
        if context.window is None:
            return self.execute(context)
        if not self._check_no_job_runs():
            return {"CANCELLED"}
        start_in_background(self.prepare(context), self.bl_label, tool_of(type(self).bl_idname), self.prepare_follow_up(context))
        return {"INTERFACE"}  # handled, but nothing to undo or repeat yet

    def _check_no_job_runs(self) -> bool:
        if _current is not None:
            report_message(self, f'"{_current.title}" is still running; wait for it or cancel it with Esc.', "ERROR")
        return _current is None


class FARFIELD_OT_finish_job(bpy.types.Operator):
    """Do the half of the running job that uses the scene, with one undo step at its end"""

    bl_idname = "farfield.finish_job"
    bl_label = "Finish Job"
    bl_options = {"INTERNAL"}

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start to advance the job; events do not reach the rest of Blender until it ends."""
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Advance the job for one tick."""
        run = _current
        if run is None:  # another file was opened
            self.cancel(context)
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            run.cancel()
        elif event.type == "TIMER":
            try:
                finished = run.advance()
            except Exception as error:  # noqa: BLE001 catch-all, see CONTRIBUTING.md
                self.cancel(context)
                return report_error(self, error, run.title)
            if finished:
                self.cancel(context)
                store_result(context.scene, run.tool, run.message)
                bpy.ops.ed.undo_push(message=run.title)
                report_result(self, run.message)
                run.follow_up()
                return {"FINISHED"}
        _show_status()
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """End the job: it has finished, the window is closed or Blender quits."""
        context.window_manager.event_timer_remove(self._timer)
        cancel_current()


class FARFIELD_OT_cancel_job(bpy.types.Operator):
    """Cancel the running job of Farfield. The scene stays as it was"""

    bl_idname = "farfield.cancel_job"
    bl_label = "Cancel Farfield Job"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a job runs; Esc has its usual meaning otherwise."""
        return poll_with_reason(cls, "" if _current is not None and context.window is not None else "No job is running")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask the job to end before its next step."""
        _current.cancel()
        _show_status()
        return {"FINISHED"}


def start_in_background(
    job: Job, title: str, tool: str = "", follow_up: Callable[[], None] = lambda: None, cancel_message: str = NOTHING_CHANGED
) -> None:
    """Start `job` while the interface stays usable; no other job may run. It becomes one undo step with this title.

    tool, follow_up, cancel_message: see `Run`.
    """
    global _current
    _current = Run(job, title, tool, follow_up, cancel_message)
    bpy.app.timers.register(_watch_core, first_interval=TICK)
    bpy.app.handlers.load_pre.append(_cancel_before_loading)
    _show_status()


def cancel_current() -> None:
    """End the running job, if there is one, and forget it."""
    global _current
    run, _current = _current, None
    if _cancel_before_loading in bpy.app.handlers.load_pre:
        bpy.app.handlers.load_pre.remove(_cancel_before_loading)
    if bpy.app.timers.is_registered(_watch_core):
        bpy.app.timers.unregister(_watch_core)
    if run is not None:
        try:
            run.close()
        finally:
            _show_status()


def _watch_core() -> float | None:
    """Show the progress of the first half of the job, and start the second half when it has ended and no render runs."""
    if _current is None:
        return None
    is_done = _current.check_core()
    _show_status()
    windows = bpy.context.window_manager.windows
    if not is_done or not windows or bpy.app.is_job_running("RENDER"):
        return TICK
    with bpy.context.temp_override(window=windows[0]):
        bpy.ops.farfield.finish_job("INVOKE_DEFAULT")
    return None


def _show_status() -> None:
    """Update the status bars and the progress bars in the sidebars if the status has changed."""
    global _shown_status
    text = "" if _current is None else status_text(_current)
    if text == _shown_status:
        return
    _shown_status = text
    for window in bpy.context.window_manager.windows:
        window.workspace.status_text_set(text or None)
    redraw_sidebars(bpy.context.window_manager)


@bpy.app.handlers.persistent
def _cancel_before_loading(*_: Any) -> None:
    cancel_current()


register_classes, unregister_classes = bpy.utils.register_classes_factory((FARFIELD_OT_finish_job, FARFIELD_OT_cancel_job))


def register() -> None:
    """Register the operators and Esc as the key that cancels a job."""
    register_classes()
    key_configuration = bpy.context.window_manager.keyconfigs.addon
    if key_configuration is not None:  # in background mode it is None
        keymap = key_configuration.keymaps.new(name="Window", space_type="EMPTY", region_type="WINDOW")
        _keymap_items.append((keymap, keymap.keymap_items.new(FARFIELD_OT_cancel_job.bl_idname, "ESC", "PRESS")))


def unregister() -> None:
    """Cancel a running job, remove the key and unregister the operators."""
    cancel_current()
    for keymap, item in _keymap_items:
        keymap.keymap_items.remove(item)
    _keymap_items.clear()
    unregister_classes()
