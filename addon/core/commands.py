"""Command lines that run in processes of their own, on this machine or on those of a Dask scheduler, and end when they should."""

import os
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from dataclasses import dataclass, field

from .errors import FarfieldError, Stopped
from .parallel import Spread, open_executor

HIDDEN = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # Windows would open a console for each
TEMPORARY_FOLDER_NAMES = ("TMPDIR", "TMP", "TEMP")


@dataclass
class Commands:
    """What `open_commands` yields. Processes of this machine are killed by their own handles when it closes."""

    spread: Spread
    scratch: str
    _running: set[subprocess.Popen] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _closed: bool = False

    def submit(self, command: list[str]) -> "Future[subprocess.CompletedProcess]":
        """Run `command`, when its turn comes; `outcome` reads the future."""
        if self.spread.here:
            return self.spread.executor.submit(self._run, command)
        # A function of the standard library: a Dask worker needs nothing of Farfield to run it.
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        return self.spread.executor.submit(subprocess.run, command, **streams)

    def close(self) -> None:
        """End the processes of this machine, and let no other begin."""
        with self._lock:
            self._closed = True
            for process in self._running:
                process.kill()

    def _run(self, command: list[str]) -> subprocess.CompletedProcess:
        variables = os.environ | dict.fromkeys(TEMPORARY_FOLDER_NAMES, self.scratch)
        with self._lock:
            if self._closed:
                raise Stopped("Stopped before it began.")
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env=variables,
                creationflags=HIDDEN,
            )
            self._running.add(process)
        try:
            _, words = process.communicate()
        finally:
            with self._lock:
                self._running.discard(process)
        return subprocess.CompletedProcess(command, process.returncode, None, words)


@contextmanager
def open_commands(word: str) -> Iterator[Commands]:
    """Where command lines run, by the word of an executor (see `parallel.read_word`). When the block ends, those of this machine have
    ended, and what they left in their temporary folder is gone; those elsewhere have to watch a lease (see `lease`).

    Raises:
        SettingsError, FarfieldError: see `parallel.open_executor`.
    """
    with tempfile.TemporaryDirectory(prefix="farfield-", ignore_cleanup_errors=True) as scratch, open_executor(word) as spread:
        commands = Commands(spread, scratch)
        try:
            yield commands
        finally:
            commands.close()


def outcome(finished: "Future[subprocess.CompletedProcess]") -> tuple[int, str]:
    """Exit code of a command, negative for the signal that killed it, and what it said on stderr.

    Raises:
        FarfieldError: when the command cannot be started or its Dask scheduler has gone.
    """
    try:
        result = finished.result()
    except CancelledError:
        raise FarfieldError("The Dask scheduler has gone, or has dropped this work; start it again and resume.") from None
    except OSError as error:
        raise FarfieldError(f"A worker process cannot be started where the work runs: {error}.") from error
    return result.returncode, result.stderr.decode("utf-8", errors="replace")
