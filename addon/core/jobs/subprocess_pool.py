"""Commands run in subprocesses, on this machine or on those of a Dask scheduler, and killed when their block ends."""

import os
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from ..errors import Cancelled, FarfieldError
from ..files.file_access import convert_os_errors
from ..files.temporary_folders import temporary_folder
from .executors import OpenExecutor, open_executor

NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # Windows would open a console for each process
TEMPORARY_FOLDER_VARIABLES = ("TMPDIR", "TMP", "TEMP")


@dataclass
class SubprocessPool:
    """Runs commands in subprocesses; see `open_subprocess_pool`. Local processes are killed by their handles on `close`."""

    executor: OpenExecutor
    temporary_folder: str
    _running: set[subprocess.Popen] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _is_closed: bool = False

    def submit(self, command: list[str]) -> "Future[subprocess.CompletedProcess]":
        """Run `command` when a slot is free; pass the future to `wait_for_exit`."""
        if self.executor.is_local:
            return self.executor.executor.submit(self._run, command)
        # A function of the standard library: a Dask worker can run it without Farfield.
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        return self.executor.executor.submit(subprocess.run, command, **streams)

    def close(self) -> None:
        """Kill the local processes and start no more."""
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
def open_subprocess_pool(executor_spec: str) -> Iterator[SubprocessPool]:
    """Open a pool on the executor with this spec, see `executors.parse_executor`.

    At the end of the block the local processes are dead and their temporary folder is deleted. Processes on other machines have to watch a
    heartbeat file, see `heartbeat`.

    Raises:
        SettingsError, FarfieldError: see `executors.open_executor`.
        FileError: the temporary folder cannot be created.
    """
    with ExitStack() as stack:
        with convert_os_errors("A temporary folder cannot be created"):
            folder = stack.enter_context(temporary_folder())
        pool = SubprocessPool(stack.enter_context(open_executor(executor_spec)), str(folder))
        try:
            yield pool
        finally:
            pool.close()


def wait_for_exit(future: "Future[subprocess.CompletedProcess]") -> tuple[int, str]:
    """Wait for a command; return its exit code, negative for the signal that killed it, and its output on stderr.

    Raises:
        FarfieldError: the command cannot be started, or the Dask scheduler no longer answers.
    """
    try:
        process = future.result()
    except CancelledError:
        raise FarfieldError("The Dask scheduler stopped or dropped this work; restart it and resume.") from None
    except OSError as error:
        raise FarfieldError(f"A worker process cannot be started where the work runs: {error}.") from error
    return process.returncode, process.stderr.decode("utf-8", errors="replace")
