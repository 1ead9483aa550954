"""Pools of workers that call one function of a module for many items, level after level of a long job.

A module of tasks has `open_tasks(arguments)`, which returns the function. It takes an item and returns a reply, both made of the types of
JSON; large data goes through files. Items and replies pass through JSON even where the function runs in this process, and matrix products
use one thread everywhere, so every executor gives the same replies.
"""

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Protocol

from ..files.file_access import convert_os_errors
from ..files.temporary_folders import temporary_folder
from .chunks import blas_thread_limit
from .core_worker import core_command, import_extension_module
from .heartbeat import Heartbeat
from .progress import Progress, Steps
from .task_processes import ProcessTaskPool
from .task_worker import Task, task_arguments

POLL_SECONDS = 0.1  # between two progress updates
WORKER_MODULE = "addon.core.jobs.task_worker"


class TaskPool(Protocol):
    """Workers that call the function of a module of tasks."""

    def run(self, items: Sequence[Any], label: str) -> Steps[list[Any]]:
        """Call the function for every item; return the replies in the order of the items. `label` is that of the progress.

        The items may run at the same time and in any order. May be called again and again, one run at a time. Closing this generator ends
        local workers before it returns.

        Raises:
            FarfieldError: the function raises a FarfieldError, whose message is passed on; a worker runs out of memory, crashes twice at
                the same item or cannot be started.
            RuntimeError: the function raises another exception in a worker.
            FileError: another run takes over the folder of the heartbeat.
        """


@contextmanager
def open_task_pool(processes: int, module: str, arguments: list[str], held: Heartbeat, items_name: str = "tasks") -> Iterator[TaskPool]:
    """Open a pool of processes of this machine for the tasks of a `module` of the extension, for instance `addon.core.bdam.build_tasks`.

    processes: how many worker processes are started at most, as items need them; they live until the end of the block. held: heartbeat of
    the job; `run` renews it, and workers exit when it ends. items_name: what error messages call the items, in plural.

    Raises:
        FarfieldError: this Blender has no Python program.
        FileError: a temporary folder cannot be created.
    """
    with ExitStack() as stack:
        command = worker_command(module, arguments, held)
        with convert_os_errors("A temporary folder cannot be created"):
            folder = stack.enter_context(temporary_folder())
        pool = ProcessTaskPool(command, processes, held, folder, items_name)
        stack.callback(pool.close)
        yield pool


def create_serial_pool(module: str, arguments: list[str], held: Heartbeat) -> "SerialTaskPool":
    """Return a pool that runs the tasks of a `module` in this process and thread; see `open_task_pool`. Raises errors of `open_tasks`."""
    return SerialTaskPool(import_extension_module(module).open_tasks(arguments), held)


def worker_command(module: str, arguments: list[str], held: Heartbeat) -> list[str]:
    """Return the command of a worker process for the tasks of a `module`. Raises FarfieldError if this Blender has no Python program."""
    return core_command(WORKER_MODULE, task_arguments(module, arguments, held.path))


class SerialTaskPool:
    """Calls a function in this process and thread; see `TaskPool`."""

    def __init__(self, task: Task, held: Heartbeat) -> None:
        self._task, self._held = task, held

    def run(self, items: Sequence[Any], label: str) -> Steps[list[Any]]:
        """Call the function for every item; see `TaskPool.run`."""
        replies = []
        next_poll = time.monotonic()
        for item in items:
            if time.monotonic() >= next_poll:
                self._held.renew()
                yield Progress(len(replies) / len(items), label)
                next_poll = time.monotonic() + POLL_SECONDS
            with blas_thread_limit.limit_to_one():
                replies.append(_pass_through_json(self._task(_pass_through_json(item))))
        return replies


def _pass_through_json(value: Any) -> Any:
    return json.loads(json.dumps(value))
