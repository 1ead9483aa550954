"""Commands run in subprocesses, on this machine or where a caller's executor runs them, and killed when their block ends."""

import os
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from ..errors import Cancelled, FarfieldError
from ..files.file_access import convert_os_errors
from ..files.temporary_folders import temporary_folder

NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # Windows would open a console for each process
TEMPORARY_FOLDER_VARIABLES = ("TMPDIR", "TMP", "TEMP")


class SubprocessPool(Protocol):
    """Runs commands in subprocesses.

    slots: commands that run at the same time. workers_per_machine: the largest number of slots on one machine.
    """

    slots: int
    workers_per_machine: int

    def submit(self, command: list[str]) -> "Future[subprocess.CompletedProcess]":
        """Run `command` when a slot is free; pass the future to `wait_for_exit`."""


@dataclass
class LocalSubprocessPool:
    """Runs commands on this machine; see `open_subprocess_pool`. A thread starts each process and waits for it."""

    threads: ThreadPoolExecutor
    slots: int
    temporary_folder: str
    _running: set[subprocess.Popen] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _is_closed: bool = False

    @property
    def workers_per_machine(self) -> int:
        """The number of slots."""
        return self.slots

    def submit(self, command: list[str]) -> "Future[subprocess.CompletedProcess]":
        """Run `command` when a slot is free; see `SubprocessPool.submit`."""
        return self.threads.submit(self._run, command)

    def close(self) -> None:
        """Kill the processes and start no more."""
        with self._lock:
            self._is_closed = True
            for process in self._running:
                process.kill()

    def _run(self, command: list[str]) -> subprocess.CompletedProcess:
        environment = os.environ | dict.fromkeys(TEMPORARY_FOLDER_VARIABLES, self.temporary_folder)
        with self._lock:
            if self._is_closed:
                raise Cancelled("Cancelled before it was started.")
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env=environment,
                creationflags=NO_WINDOW,
            )
            self._running.add(process)
        try:
            _, error_output = process.communicate()
        finally:
            with self._lock:
                self._running.discard(process)
        return subprocess.CompletedProcess(command, process.returncode, None, error_output)


@contextmanager
def open_subprocess_pool(processes: int) -> Iterator[LocalSubprocessPool]:
    """Open a pool that runs up to this number of commands at the same time on this machine.

    At the end of the block queued commands are dropped, the processes are dead and their temporary folder is deleted.

    Raises:
        FileError: the temporary folder cannot be created.
    """
    with ExitStack() as stack:
        with convert_os_errors("A temporary folder cannot be created"):
            folder = stack.enter_context(temporary_folder())
        threads = ThreadPoolExecutor(processes, thread_name_prefix="farfield-task")
        stack.callback(threads.shutdown, wait=True, cancel_futures=True)
        pool = LocalSubprocessPool(threads, processes, str(folder))
        stack.callback(pool.close)
        yield pool


def wait_for_exit(future: "Future[subprocess.CompletedProcess]") -> tuple[int, str]:
    """Wait for a command; return its exit code, negative for the signal that killed it, and its output on stderr.

    Raises:
        FarfieldError: the command cannot be started, or what ran it has stopped.
    """
    try:
        process = future.result()
    except CancelledError:
        raise FarfieldError("This work was stopped or dropped where it ran; start that again and resume.") from None
    except OSError as error:
        raise FarfieldError(f"A worker process cannot be started where the work runs: {error}.") from error
    return process.returncode, process.stderr.decode("utf-8", errors="replace")
