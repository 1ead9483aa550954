"""A background thread that runs a generator of steps and can be watched and cancelled from another thread."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic

from ..errors import Cancelled
from .progress import Progress, Result, Steps, run_to_end


class BackgroundThread(Generic[Result]):
    """Runs `steps` in a thread, from construction on.

    `progress` is the latest step; any thread may read it. The steps must not access Blender's data.
    """

    def __init__(self, steps: Steps[Result]) -> None:
        self.progress = Progress(0.0, "")
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
            raise Cancelled("Cancelled; nothing was changed.")
        self.progress = progress
