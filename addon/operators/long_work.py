"""Long work in operators: blocking in scripts; in the background with progress bar, time left and Esc in the interface.

A job has two halves. `core_steps` works on arrays and runs in a thread. `scene_steps` uses Blender (Cycles renders, new objects) and runs
on the main thread, about one tick at a time. Only the end of `scene_steps` changes the scene, so a cancelled job leaves the scene as it
was, and a finished one is one undo step.
"""

import time
from typing import Any, Protocol

import bpy

from ..core.errors import Cancelled, FarfieldError
from ..core.jobs.background_thread import BackgroundThread
from ..core.jobs.progress import Progress, Steps, run_to_end, subprogress, time_left

TICK = 0.05  # seconds between two updates of the job


class Job(Protocol):
    """The work of a `LongWork` operator. It keeps no reference to Blender data between steps, only names and arrays.

    core_fraction: the part of the progress bar for the half without Blender.
    """

    core_fraction: float

    def core_steps(self) -> Steps[Any]:
        """Do the half without Blender, in any thread."""

    def scene_steps(self, core_result: Any) -> Steps[str]:
        """Do the half with Blender, on the main thread. Returns a message about the result."""


def run_job(job: Job) -> Steps[str]:
    """Run both halves of `job` in the calling thread, as scripts and `execute` do."""
    core_result = yield from subprogress(job.core_steps(), 0.0, job.core_fraction)
    return (yield from subprogress(job.scene_steps(core_result), job.core_fraction, 1.0))


class Run:
    """A job running in the background of the interface."""

    def __init__(self, job: Job, title: str) -> None:
        self.title = title
        self.progress = Progress(0.0, "Starting")
        self.message: str | None = None
        self._job = job
        self._start = time.monotonic()
        self._thread = BackgroundThread(job.core_steps())
        self._scene_steps: Steps[str] | None = None

    @property
    def uses_scene(self) -> bool:
        """Whether the job is in its second half, which uses Blender."""
        return self._scene_steps is not None

    @property
    def cancel_requested(self) -> bool:
        """Whether `cancel` was called and the job has not ended yet."""
        return self._thread.cancel_requested

    @property
    def seconds_left(self) -> float | None:
        """Remaining seconds, or None while it is too early for an estimate."""
        return time_left(time.monotonic() - self._start, self.progress.fraction)

    def cancel(self) -> None:
        """Ask the job to end before its next step."""
        self._thread.cancel()

    def close(self) -> None:
        """End the job now: wait for the thread, and let `scene_steps` restore its temporary changes."""
        self.cancel()
        self._thread.wait()
        if self._scene_steps is not None:
            self._scene_steps.close()

    def advance(self) -> bool:
        """Continue for about one tick; return True when the job has finished. Raises the exceptions of the job, including `Cancelled`."""
        if self._scene_steps is None:
            step = self._thread.progress
            self._update_progress(Progress(self._job.core_fraction * step.fraction, step.label))
            if not self._thread.is_done:
                return False
            self._scene_steps = subprogress(self._job.scene_steps(self._thread.result()), self._job.core_fraction, 1.0)
        if self.cancel_requested:
            raise Cancelled("Cancelled; nothing was changed.")
        end = time.monotonic() + TICK
        while time.monotonic() < end:
            try:
                self._update_progress(next(self._scene_steps))
            except StopIteration as finished:
                self.message = finished.value
                return True
        return False

    def _update_progress(self, step: Progress) -> None:
        """Show `step`; the progress bar never moves back, even if a job turns out to be longer than expected."""
        self.progress = Progress(max(step.fraction, self.progress.fraction), step.label)


_current: Run | None = None  # Blender's modal operators, panels and load handlers share the one running job


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


class LongWork:
    """Mixin of operators that run a `Job`. The operator implements `prepare`; the mixin implements execute, invoke, modal and cancel."""

    def prepare(self, context: bpy.types.Context) -> Job:
        """Read everything that the job needs from Blender, or raise FarfieldError."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Run the job to the end, blocking."""
        if not self._check_no_job_runs():
            return {"CANCELLED"}
        window_manager = context.window_manager
        window_manager.progress_begin(0.0, 1.0)
        try:
            message = run_to_end(run_job(self.prepare(context)), lambda step: window_manager.progress_update(step.fraction))
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            window_manager.progress_end()
        self.report({"INFO"}, message)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the job in the background and return immediately."""
        global _current
        if context.window is None:
            return self.execute(context)
        if not self._check_no_job_runs():
            return {"CANCELLED"}
        try:
            _current = Run(self.prepare(context), self.bl_label)
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._status = ""
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        bpy.app.handlers.load_pre.append(_cancel_before_loading)
        context.window_manager.modal_handler_add(self)
        self._show_status(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Advance the job; the interface stays usable between the steps, except while the job uses the scene."""
        run = _current
        if run is None:  # another file was opened
            self._clean_up(context)
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            run.cancel()
            self._show_status(context)
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"} if run.uses_scene else {"PASS_THROUGH"}
        continues = False
        try:
            continues = not run.advance()
        except FarfieldError as error:
            self.report({"INFO" if isinstance(error, Cancelled) else "ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if continues:
                self._show_status(context)
            else:
                self._clean_up(context)
        if continues:
            return {"RUNNING_MODAL"}
        self.report({"INFO"}, run.message)
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """End the job: the window is closed or Blender quits."""
        self._clean_up(context)

    def _check_no_job_runs(self) -> bool:
        if _current is not None:
            self.report({"ERROR"}, f'"{_current.title}" is still running; wait for it or cancel it with Esc.')
        return _current is None

    def _show_status(self, context: bpy.types.Context) -> None:
        """Update the progress bar and the status bar if the status has changed."""
        text = status_text(_current)
        if text != self._status:
            self._status = text
            if context.workspace is not None:
                context.workspace.status_text_set(text)
            redraw_sidebars(context.window_manager)

    def _clean_up(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        cancel_current()
        redraw_sidebars(context.window_manager)


def status_text(run: Run) -> str:
    """Return the status of `run` in one line: title, percentage, label, time left."""
    if run.cancel_requested:
        return f"{run.title}: cancelling"
    seconds = run.seconds_left
    remaining = "" if seconds is None else f", {format_duration(seconds)} left"
    return f"{run.title}: {run.progress.fraction:.0%} {run.progress.label}{remaining} (Esc to cancel)"


def format_duration(seconds: float) -> str:
    """Return `seconds` as `8 s`, `3 min 20 s` or `2 h 5 min`. Rounded up, so that jobs do not take much longer than announced."""
    total = int(-(-seconds // 1))
    if total < 60:
        return f"{total} s"
    minutes, remainder = divmod(total, 60)
    return f"{minutes} min {remainder} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def redraw_sidebars(window_manager: bpy.types.WindowManager) -> None:
    """Redraw the sidebars of all 3D Viewports."""
    for window in window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


def cancel_current() -> None:
    """End the running job, if there is one, and forget it."""
    global _current
    run, _current = _current, None
    if _cancel_before_loading in bpy.app.handlers.load_pre:
        bpy.app.handlers.load_pre.remove(_cancel_before_loading)
    if run is not None:
        run.close()


@bpy.app.handlers.persistent
def _cancel_before_loading(*_: Any) -> None:
    cancel_current()
