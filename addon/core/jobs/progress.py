"""Long work as generators of progress, a thread that runs them in the background, and a clock for the time per stage.

A long task is a generator function: it yields `Progress` between two steps and returns its result. The caller decides how a step is
shown: scripts print it, panels draw it. Both can cancel the task between two steps by closing the generator.
"""

import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from ..errors import Cancelled

MIN_FRACTION, MIN_SECONDS = 0.1, 0.5  # Below these, the pace is too uncertain for an estimate of the time left,
LONG_FRACTION, LONG_SECONDS = 0.02, 10.0  # unless it is that of a longer time.

NOTHING_CHANGED = "Cancelled; nothing was changed."

Result = TypeVar("Result")


@dataclass(frozen=True)
class Progress:
    """The state of a task: the finished `fraction`, 0 to 1, and a `label` for the user."""

    fraction: float
    label: str


Steps = Generator[Progress, None, Result]


def subprogress(steps: Steps[Result], start: float, stop: float, prefix: str = "") -> Steps[Result]:
    """Run `steps` as one stage of a larger task: map its fractions 0..1 to `start`..`stop`. Returns the result of `steps`. prefix: of its
    labels."""
    try:
        while True:
            step = next(steps)
            yield Progress(start + (stop - start) * min(max(step.fraction, 0.0), 1.0), prefix + step.label)
    except StopIteration as end:
        return end.value
    finally:
        steps.close()


def run_to_end(steps: Steps[Result], on_progress: Callable[[Progress], None] | None = None) -> Result:
    """Run `steps` to the end in this thread and return the result. An exception of `on_progress` cancels the task and propagates."""
    try:
        while True:
            step = next(steps)
            if on_progress is not None:
                on_progress(step)
    except StopIteration as end:
        return end.value
    finally:
        steps.close()


def time_left(elapsed: float, fraction: float) -> float | None:
    """Return the remaining seconds at the mean pace so far, or None while it is too early for an estimate."""
    is_early = fraction < MIN_FRACTION or elapsed < MIN_SECONDS
    if is_early and (fraction < LONG_FRACTION or elapsed < LONG_SECONDS):
        return None
    return elapsed * (1.0 - fraction) / fraction


class StageClock:
    """Wall-clock seconds by stage name, summed over repeated stages, and over threads."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._lock = threading.Lock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent in the block to the stage `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            with self._lock:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


class BackgroundThread(Generic[Result]):
    """Runs `steps` in a thread, from construction on.

    `progress` is the latest step; any thread may read it. The steps must not access Blender's data. cancel_message: of `Cancelled`.
    """

    def __init__(self, steps: Steps[Result], cancel_message: str = NOTHING_CHANGED) -> None:
        self.progress, self.cancel_message = Progress(0.0, ""), cancel_message
        self._cancel_event = threading.Event()
        executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="farfield")
        self._future: Future[Result] = executor.submit(run_to_end, steps, self._on_progress)
        executor.shutdown(wait=False)

    @property
    def is_done(self) -> bool:
        """Whether the thread has ended: with a result, an error or cancelled."""
        return self._future.done()

    @property
    def cancel_requested(self) -> bool:
        """Whether `cancel` was called."""
        return self._cancel_event.is_set()

    def result(self) -> Result:
        """Wait for the steps and return their result. Raises their exception, including `Cancelled`."""
        return self._future.result()

    def cancel(self) -> None:
        """Ask the steps to end; they do so before the next step."""
        self._cancel_event.set()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until the thread has ended, at most `seconds`; return whether it has."""
        ended = threading.Event()
        self._future.add_done_callback(lambda _: ended.set())
        return ended.wait(seconds)

    def _on_progress(self, progress: Progress) -> None:
        if self.cancel_requested:
            raise Cancelled(self.cancel_message)
        self.progress = progress
