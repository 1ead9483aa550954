"""Executors of scripts: those of the extension, and `dask:tcp://HOST:PORT` for the workers of a Dask scheduler.

Dask is no part of the extension. It needs the package `distributed`.
"""

import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Executor as ConcurrentExecutor
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FarfieldError, SettingsError
from farfield.addon.core.files.file_access import convert_os_errors
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.jobs.executors import Executor, parse_executor
from farfield.addon.core.jobs.heartbeat import Heartbeat
from farfield.addon.core.jobs.task_pool import worker_command
from lib.file_task_pool import FileTaskPool

CONNECT_SECONDS = 5.0  # timeout of a Dask scheduler
DASK = "dask:"
DASK_PATTERN = re.compile(r"dask:((?:tcp|tls|ucx|wss?)://[^\s/]+:\d+)")
DASK_HELP = "--executor also takes dask:tcp://HOST:PORT, the address of a Dask scheduler."
STREAMS = {
    "stdin": subprocess.DEVNULL,
    "stdout": subprocess.DEVNULL,
    "stderr": subprocess.PIPE,
}  # Commands have no input; their messages are returned.


@contextmanager
def open_executor(text: str) -> Iterator[Executor]:
    """Open the executor of the flag `--executor`: `dask:tcp://HOST:PORT`, or a word of the extension, see `parse_executor`.

    Raises:
        SettingsError: `text` is no executor.
        FarfieldError: Dask is not installed, or no scheduler with workers answers.
    """
    if not text.strip().startswith(DASK):
        yield parse_executor(text)
        return
    match = DASK_PATTERN.fullmatch(text.strip())
    if match is None:
        raise SettingsError(f'Executor must be dask:tcp://HOST:PORT with Dask, not "{text}".', ("executor",))
    with _connect(match[1]) as client:
        threads = client.nthreads()
        if not threads:
            raise FarfieldError(f'The Dask scheduler at "{match[1]}" has no workers; start some and run it again.')
        machines = Counter()
        for address, count in threads.items():
            machines[address.rpartition(":")[0]] += count
        yield DaskExecutor(client, sum(threads.values()), max(machines.values()))


@dataclass(frozen=True)
class DaskExecutor:
    """Runs work on the workers of a Dask scheduler; see `executors.Executor`. client: connection to the scheduler."""

    client: Any
    slots: int
    workers_per_machine: int

    @contextmanager
    def open_subprocess_pool(self) -> Iterator["DaskSubprocessPool"]:
        """Open a pool for commands. Queued ones are dropped at the end of the block; processes that run watch a heartbeat file."""
        executor = self.client.get_executor(pure=False)
        try:
            yield DaskSubprocessPool(executor, self.slots, self.workers_per_machine)
        finally:
            executor.shutdown(wait=False)  # cancels queued tasks

    @contextmanager
    def open_task_pool(self, module: str, arguments: list[str], held: Heartbeat, items_name: str) -> Iterator[FileTaskPool]:
        """Open a pool for the tasks of a module; see `task_pool.open_task_pool`.

        It starts a process per run and slot. Items and replies are files next to the heartbeat file, whose folder all machines must be able
        to reach.
        """
        parent = held.path.parent
        command = worker_command(module, arguments, held)
        with ExitStack() as stack:
            pool = stack.enter_context(self.open_subprocess_pool())
            with convert_os_errors(f'A temporary folder cannot be created in "{parent}"'):
                folder = stack.enter_context(temporary_folder(parent))
            yield FileTaskPool(command, pool, held, folder, items_name)


@dataclass(frozen=True)
class DaskSubprocessPool:
    """Runs commands on the workers of a Dask scheduler; see `subprocess_pool.SubprocessPool`."""

    executor: ConcurrentExecutor
    slots: int
    workers_per_machine: int

    def submit(self, command: list[str]) -> "Future[subprocess.CompletedProcess]":
        """Run `command` when a slot is free. It is run by a function of the standard library, so workers need no Farfield for that."""
        return self.executor.submit(subprocess.run, command, **STREAMS)


@contextmanager
def _connect(address: str) -> Iterator[Any]:
    """Connect to the Dask scheduler at `address`; yields the client."""
    try:
        import distributed
    except ImportError:
        raise FarfieldError(
            "Dask is not installed for this Python; install the package distributed there, or set Executor to processes."
        ) from None
    try:
        client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise FarfieldError(
            f'No Dask scheduler answers at "{address}" within {CONNECT_SECONDS:g} seconds; start one there, or set Executor to processes.'
        ) from error
    try:
        yield client
    finally:
        client.close(timeout=CONNECT_SECONDS)
