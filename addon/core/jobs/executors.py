"""Executors for work that spreads over processes. Equal input gives equal bytes, serial or spread."""

import os
import re
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Protocol

from ..errors import SettingsError
from .heartbeat import Heartbeat
from .subprocess_pool import SubprocessPool, open_subprocess_pool
from .task_pool import TaskPool, create_serial_pool, open_task_pool

MAX_DEFAULT_PROCESSES = 8  # For the word `processes`: each process holds the scene in memory.
EXECUTOR_PATTERN = re.compile(r"(serial)|processes(?::([1-9]\d{0,3}))?")


class Executor(Protocol):
    """Where work runs that spreads. Jobs take one from their caller, or make a `LocalExecutor` of their setting *Executor*."""

    def open_subprocess_pool(self) -> AbstractContextManager[SubprocessPool]:
        """Open a pool for commands; processes on other machines have to watch a heartbeat file. Raises FarfieldError."""

    def open_task_pool(self, module: str, arguments: list[str], held: Heartbeat, items_name: str) -> AbstractContextManager[TaskPool]:
        """Open a pool for the tasks of a module; see `task_pool.open_task_pool`."""


@dataclass(frozen=True)
class LocalExecutor:
    """Runs work in a number of processes of this machine. is_serial: whether work that needs no process of its own runs in this one."""

    processes: int
    is_serial: bool = False

    def open_subprocess_pool(self) -> AbstractContextManager[SubprocessPool]:
        """Open a pool for commands; see `subprocess_pool.open_subprocess_pool`."""
        return open_subprocess_pool(self.processes)

    def open_task_pool(self, module: str, arguments: list[str], held: Heartbeat, items_name: str) -> AbstractContextManager[TaskPool]:
        """Open a pool for the tasks of a module; see `task_pool.open_task_pool`."""
        if self.is_serial:
            return nullcontext(create_serial_pool(module, arguments, held))
        return open_task_pool(self.processes, module, arguments, held, items_name)


def parse_executor(text: str) -> LocalExecutor:
    """Parse `serial`, `processes` or `processes:N`.

    Raises:
        SettingsError: `text` has none of these forms.
    """
    match = EXECUTOR_PATTERN.fullmatch(text.strip())
    if match is None:
        raise SettingsError(f'Executor must be serial, processes, or processes:N with N at least 1, not "{text}".', ("executor",))
    is_serial, count = match.groups()
    default_count = min(os.cpu_count() or 1, MAX_DEFAULT_PROCESSES)
    return LocalExecutor(1 if is_serial else int(count) if count else default_count, bool(is_serial))
