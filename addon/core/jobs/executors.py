"""Executors for work that spreads over processes and machines. Equal input gives equal bytes, serial or distributed."""

import ipaddress
import os
import re
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from ..errors import FarfieldError, SettingsError

MAX_DEFAULT_PROCESSES = 8  # For the spec `processes`: each process holds the scene in memory.
CONNECT_SECONDS = 5.0  # timeout of a Dask scheduler
EXECUTOR_PATTERN = re.compile(r"(serial)|processes(?::([1-9]\d{0,3}))?|dask:((?:tcp|tls|ucx|wss?)://[^\s/]+:\d+)")


@dataclass(frozen=True)
class OpenExecutor:
    """An open executor and its capacity.

    Local tasks run in threads, so they should start processes and wait for them. slots: tasks that run at the same time.
    workers_per_machine: the largest number of slots on one machine. is_local: whether the tasks run on this machine; elsewhere a task is a
    function of the standard library, since Farfield may not be installed there.
    """

    executor: Executor
    slots: int
    workers_per_machine: int
    is_local: bool


@dataclass(frozen=True)
class ExecutorSpec:
    """A parsed executor spec: a number of local processes, or the address of a Dask scheduler.

    is_serial: whether work that needs no process of its own runs in this one.
    """

    processes: int
    scheduler: str | None
    is_serial: bool = field(default=False, compare=False)

    @property
    def uses_network(self) -> bool:
        """Whether the scheduler may be on another machine."""
        if self.scheduler is None:
            return False
        host = urlsplit(self.scheduler).hostname or ""
        try:
            return not ipaddress.ip_address(host).is_loopback
        except ValueError:
            return host != "localhost"


def parse_executor(text: str) -> ExecutorSpec:
    """Parse `serial`, `processes`, `processes:N` or `dask:tcp://HOST:PORT`.

    Raises:
        SettingsError: `text` has none of these forms.
    """
    match = EXECUTOR_PATTERN.fullmatch(text.strip())
    if match is None:
        raise SettingsError(
            f'Executor must be serial, processes, processes:N with N at least 1, or dask:tcp://HOST:PORT, not "{text}".', ("executor",)
        )
    serial, count, scheduler = match.groups()
    default_count = min(os.cpu_count() or 1, MAX_DEFAULT_PROCESSES)
    return ExecutorSpec(1 if serial else int(count) if count else default_count, scheduler, bool(serial))


@contextmanager
def open_executor(text: str) -> Iterator[OpenExecutor]:
    """Open the executor with the spec `text`, see `parse_executor`. Tasks still queued at the end of the block are cancelled.

    Raises:
        SettingsError: `text` is not an executor spec.
        FarfieldError: Dask is not installed, or no scheduler with workers answers.
    """
    spec = parse_executor(text)
    if spec.scheduler is not None:
        with _connect(spec.scheduler) as client:
            threads = client.nthreads()
            machines = Counter()
            for address, count in threads.items():
                machines[address.rpartition(":")[0]] += count
            if not threads:
                raise FarfieldError(f'The Dask scheduler at "{spec.scheduler}" has no workers; start some and run it again.')
            executor = client.get_executor(pure=False)
            try:
                yield OpenExecutor(executor, sum(threads.values()), max(machines.values()), is_local=False)
            finally:
                executor.shutdown(wait=False)  # cancels queued tasks
        return
    executor = ThreadPoolExecutor(spec.processes, thread_name_prefix="farfield-task")
    try:
        yield OpenExecutor(executor, spec.processes, spec.processes, is_local=True)
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def check_executor(text: str) -> None:
    """Check that the executor with the spec `text` can be opened, before anything is written for it.

    Raises:
        SettingsError, FarfieldError: see `open_executor`.
    """
    if parse_executor(text).scheduler is not None:
        with open_executor(text):
            pass


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
