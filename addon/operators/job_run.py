"""Jobs in two halves, and their progress while they run in the background of the interface.

`core_steps` works on arrays and runs in a thread. `scene_steps` uses Blender (Cycles renders, new objects) and runs on the main thread,
about one tick at a time. Only the end of `scene_steps` changes the scene, so a cancelled job leaves the scene as it was, and a finished
one is one undo step.
"""

import time
from collections.abc import Callable
from typing import Any, Protocol

from ..core.errors import Cancelled
from ..core.jobs.progress import NOTHING_CHANGED, BackgroundThread, Progress, Steps, subprogress, time_left

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
    """A job running in the background of the interface.

    tool: whose panel shows the result. follow_up: is called after the undo step of a run that has finished. cancel_message: what the user
    reads about a cancelled run.
    """

    def __init__(
        self, job: Job, title: str, tool: str = "", follow_up: Callable[[], None] = lambda: None, cancel_message: str = NOTHING_CHANGED
    ) -> None:
        self.title, self.tool, self.follow_up = title, tool, follow_up
        self.progress = Progress(0.0, "Starting")
        self.message: str | None = None
        self._job = job
        self._start = time.monotonic()
        self._thread = BackgroundThread(job.core_steps(), cancel_message)
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

    def check_core(self) -> bool:
        """Update the progress of the half without Blender; return whether that half has ended, in whatever way."""
        step = self._thread.progress
        self._update_progress(Progress(self._job.core_fraction * step.fraction, step.label))
        return self._thread.is_done

    def advance(self) -> bool:
        """Continue for about one tick; return True when the job has finished. Raises the exceptions of the job, including `Cancelled`."""
        if self._scene_steps is None:
            if not self.check_core():
                return False
            self._scene_steps = subprogress(self._job.scene_steps(self._thread.result()), self._job.core_fraction, 1.0)
        if self.cancel_requested:
            raise Cancelled(self._thread.cancel_message)
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
