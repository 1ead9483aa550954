"""Long work in operators: blocking in scripts, in the background of a window with a bar, the time left, and Esc.

A job has two halves. `core_steps` works on arrays and runs in a thread; `scene_steps` uses Blender (Cycles renders, new objects) and
runs on the main thread, a step or two a timer tick. Only the end of `scene_steps` changes the scene, so that a stopped job leaves it as
it was and a finished one is one undo step.
"""

import time
from typing import Any, Protocol

import bpy

from ..core.errors import FarfieldError, Stopped
from ..core.progress import Progress, Steps, finish, scaled, time_left
from ..core.worker import Worker

TICK = 0.05  # seconds between two looks at the job


class Job(Protocol):
    """What `LongWork` runs. It keeps no reference to Blender data between steps, only names and arrays.

    core_share: of the bar, what the half without Blender takes.
    """

    core_share: float

    def core_steps(self) -> Steps[Any]:
        """The part without Blender, for any thread."""

    def scene_steps(self, core_result: Any) -> Steps[str]:
        """The part with Blender, for the main thread. Returns the sentence that tells what was made."""


def whole(job: Job) -> Steps[str]:
    """Both halves of `job` one after the other, in the thread that runs them: what scripts and `execute` use."""
    core_result = yield from scaled(job.core_steps(), 0.0, job.core_share)
    return (yield from scaled(job.scene_steps(core_result), job.core_share, 1.0))


class Run:
    """A job under way in a window."""

    def __init__(self, job: Job, title: str) -> None:
        self.title = title
        self.progress = Progress(0.0, "Starting")
        self.sentence: str | None = None
        self._job = job
        self._started = time.monotonic()
        self._worker = Worker(job.core_steps())
        self._scene_steps: Steps[str] | None = None

    @property
    def in_scene(self) -> bool:
        """Whether the job is in its half that uses Blender."""
        return self._scene_steps is not None

    @property
    def stopping(self) -> bool:
        """Whether the job was told to stop and has not yet."""
        return self._worker.stopping

    @property
    def seconds_left(self) -> float | None:
        """Seconds that remain, or None while it is too early to tell."""
        return time_left(time.monotonic() - self._started, self.progress.fraction)

    def stop(self) -> None:
        """Tell the job to end between two steps."""
        self._worker.stop()

    def close(self) -> None:
        """End the job now: wait for the thread, let the scene half put back what it changed."""
        self.stop()
        self._worker.wait()
        if self._scene_steps is not None:
            self._scene_steps.close()

    def advance(self) -> bool:
        """Go on for about one tick; True when the job has finished. What the job raises is raised here, `Stopped` too."""
        if self._scene_steps is None:
            step = self._worker.progress
            self._take(Progress(self._job.core_share * step.fraction, step.label))
            if not self._worker.done:
                return False
            self._scene_steps = scaled(self._job.scene_steps(self._worker.result()), self._job.core_share, 1.0)
        if self.stopping:
            raise Stopped("Stopped; nothing was changed.")
        until = time.monotonic() + TICK
        while time.monotonic() < until:
            try:
                self._take(next(self._scene_steps))
            except StopIteration as finished:
                self.sentence = finished.value
                return True
        return False

    def _take(self, step: Progress) -> None:
        """Show `step`; the bar never goes back, also where a job finds that it has more to do than it thought."""
        self.progress = Progress(max(step.fraction, self.progress.fraction), step.label)


_current: Run | None = None


def current() -> Run | None:
    """The job that runs in this window, if there is one."""
    return _current


def busy() -> str:
    """Why nothing else can be started now, or an empty string."""
    return "" if _current is None else f"{_current.title} is still running"


def allowed(operator: type[bpy.types.Operator], reason: str) -> bool:
    """The answer of an operator's `poll`: whether there is no `reason` against it, which Blender then shows."""
    if reason:
        operator.poll_message_set(reason)
    return not reason


class LongWork:
    """Mixin of operators whose work is a `Job`. The operator supplies `prepare`; this supplies execute, invoke, modal and cancel."""

    def prepare(self, context: bpy.types.Context) -> Job:
        """Read all that the work needs out of Blender, or raise FarfieldError."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Run to the end, blocking."""
        if not self._free():
            return {"CANCELLED"}
        window_manager = context.window_manager
        window_manager.progress_begin(0.0, 1.0)
        try:
            sentence = finish(whole(self.prepare(context)), lambda step: window_manager.progress_update(step.fraction))
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            window_manager.progress_end()
        self.report({"INFO"}, sentence)
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the work beside the window's own and come back at once."""
        global _current
        if context.window is None:
            return self.execute(context)
        if not self._free():
            return {"CANCELLED"}
        try:
            _current = Run(self.prepare(context), self.bl_label)
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._shown = ""
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        bpy.app.handlers.load_pre.append(_close_before_loading)
        context.window_manager.modal_handler_add(self)
        self._show(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on a little; between the steps the window is free, but for the moments when the scene is being rendered from."""
        run = _current
        if run is None:  # another file was opened
            self._end(context)
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            run.stop()
            self._show(context)
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"} if run.in_scene else {"PASS_THROUGH"}
        going_on = False
        try:
            going_on = not run.advance()
        except FarfieldError as error:
            self.report({"INFO" if isinstance(error, Stopped) else "ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if going_on:
                self._show(context)
            else:
                self._end(context)
        if going_on:
            return {"RUNNING_MODAL"}
        self.report({"INFO"}, run.sentence)
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """The window closes or Blender quits."""
        self._end(context)

    def _free(self) -> bool:
        if _current is not None:
            self.report({"ERROR"}, f'"{_current.title}" is still running; wait for it or stop it with Esc.')
        return _current is None

    def _show(self, context: bpy.types.Context) -> None:
        """Draw the bar anew and say in the status bar where the work is, when that has changed."""
        text = status_text(_current)
        if text != self._shown:
            self._shown = text
            if context.workspace is not None:
                context.workspace.status_text_set(text)
            redraw_sidebars(context.window_manager)

    def _end(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        close()
        redraw_sidebars(context.window_manager)


def status_text(run: Run) -> str:
    """One line on where `run` is: task, per cent, label, time left."""
    if run.stopping:
        return f"{run.title}: stopping"
    left = run.seconds_left
    remaining = "" if left is None else f", {duration(left)} left"
    return f"{run.title}: {run.progress.fraction:.0%} {run.progress.label}{remaining} (Esc stops)"


def duration(seconds: float) -> str:
    """`seconds` for people: `8 s`, `3 min 20 s`, `2 h 5 min`. Rounded up, so that work never outlives what was said by much."""
    whole_seconds = int(-(-seconds // 1))
    if whole_seconds < 60:
        return f"{whole_seconds} s"
    minutes, rest = divmod(whole_seconds, 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def redraw_sidebars(window_manager: bpy.types.WindowManager) -> None:
    """Have the sidebars of all 3D views drawn anew."""
    for window in window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


def close() -> None:
    """End the current job, if there is one, and forget it."""
    global _current
    run, _current = _current, None
    if _close_before_loading in bpy.app.handlers.load_pre:
        bpy.app.handlers.load_pre.remove(_close_before_loading)
    if run is not None:
        run.close()


@bpy.app.handlers.persistent
def _close_before_loading(*_: Any) -> None:
    close()
