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
from .executors import parse_executor
from .heartbeat import Heartbeat
from .progress import Progress, Steps
from .subprocess_pool import open_subprocess_pool
from .task_processes import ProcessTaskPool
from .task_shards import ShardTaskPool
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
def open_task_pool(executor_spec: str, module: str, arguments: list[str], held: Heartbeat, items_name: str = "tasks") -> Iterator[TaskPool]:
    """Open a pool for the tasks of a `module` of the extension, for instance `addon.core.bdam.build_tasks`.

    executor_spec: see `executors.parse_executor`. `serial` calls the function in this process and thread. `processes:N` starts up to N
    worker processes as items need them; they live until the end of the block. `dask:...` starts a process per run and slot, and passes
    items and replies through files beside the heartbeat file, whose folder all machines must be able to reach. held: heartbeat of the
    job; `run` renews it, and workers exit when it ends. items_name: what error messages call the items, in plural.

    Raises:
        SettingsError: the executor spec is invalid.
        FarfieldError: with `serial`, errors of `open_tasks`; Dask is not installed, or no scheduler with workers answers; this Blender has
            no Python program.
        FileError: a temporary folder cannot be created.
    """
    spec = parse_executor(executor_spec)
    if spec.is_serial:
        yield SerialTaskPool(import_extension_module(module).open_tasks(arguments), held)
        return
    command = core_command(WORKER_MODULE, task_arguments(module, arguments, held.path))
    with ExitStack() as stack:
        if spec.scheduler is None:
            with convert_os_errors("A temporary folder cannot be created"):
                folder = stack.enter_context(temporary_folder())
            pool = ProcessTaskPool(command, spec.processes, held, folder, items_name)
            stack.callback(pool.close)
            yield pool
        else:
            processes = stack.enter_context(open_subprocess_pool(executor_spec))
            with convert_os_errors(f'A temporary folder cannot be created in "{held.path.parent}"'):
                folder = stack.enter_context(temporary_folder(held.path.parent))
            yield ShardTaskPool(command, processes, held, folder, items_name)


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
