"""Steps run in a thread of their own, watched and stopped from another one."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic

from .errors import Stopped
from .progress import Progress, Result, Steps, finish


class Worker(Generic[Result]):
    """Runs `steps` in a thread from the moment it is made.

    `progress` is the latest step; reading it is safe from any thread. The steps must not touch Blender's data.
    """

    def __init__(self, steps: Steps[Result]) -> None:
        self.progress = Progress(0.0, "")
        self._stopping = threading.Event()
        executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="farfield")
        self._future: Future[Result] = executor.submit(finish, steps, self._on_progress)
        executor.shutdown(wait=False)

    @property
    def done(self) -> bool:
        """Whether the thread has ended, in whatever way."""
        return self._future.done()

    @property
    def stopping(self) -> bool:
        """Whether `stop` was called."""
        return self._stopping.is_set()

    def result(self) -> Result:
        """What the steps returned; waits for them. An exception of theirs, `Stopped` too, is raised here."""
        return self._future.result()

    def stop(self) -> None:
        """Ask the steps to end; they do so between two of them."""
        self._stopping.set()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until the thread has ended, at most `seconds`; whether it has."""
        finished = threading.Event()
        self._future.add_done_callback(lambda _: finished.set())
        return finished.wait(seconds)

    def _on_progress(self, progress: Progress) -> None:
        if self.stopping:
            raise Stopped("Stopped; nothing was changed.")
        self.progress = progress
