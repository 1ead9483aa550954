"""Pools of workers that call one function of a module for many items, level after level of a long job.

A module of tasks has `open_tasks(arguments)`, which returns the function. It takes an item and returns a reply, both made of the types of
JSON; large data goes through files. Items and replies pass through JSON even where the function runs in this process, and matrix products
use one thread everywhere, so every executor gives the same replies.
"""

import json
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

from ..files.file_access import convert_os_errors
from ..files.temporary_folders import temporary_folder
from .chunks import blas_thread_limit
from .core_worker import core_command, import_extension_module
from .dispatch import Shard, run_shards, split_evenly
from .executors import parse_executor
from .heartbeat import Heartbeat
from .progress import Progress, Steps
from .subprocess_pool import SubprocessPool, open_subprocess_pool
from .task_processes import ProcessTaskPool
from .task_worker import Task, file_arguments, read_reply, task_arguments

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
    items and replies through files next to the heartbeat file, whose folder all machines must be able to reach. held: heartbeat of the
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


class ShardTaskPool:
    """Gives items to subprocesses of `pool` that run `command`, through files in `folder`; see `TaskPool`."""

    def __init__(self, command: list[str], pool: SubprocessPool, held: Heartbeat, folder: Path, items_name: str) -> None:
        self._command, self._pool, self._held = command, pool, held
        self._folder, self._items_name = folder, items_name

    def run(self, items: Sequence[Any], label: str) -> Steps[list[Any]]:
        """Give the items to subprocesses; see `TaskPool.run`."""
        with convert_os_errors(f'Cannot write in the folder "{self._folder}"'):
            folder = Path(tempfile.mkdtemp(dir=self._folder))
        replies = _Replies()

        def command(shard: Shard[int]) -> list[str]:
            request_path = folder / f"{len(replies.files)}.request"
            with convert_os_errors(f'Cannot write "{request_path}"'):
                request_path.write_text(json.dumps([items[index] for index in shard.items]), encoding="utf-8")
            replies.files.append(_ReplyFile(request_path.with_suffix(".replies"), shard.items))
            return self._command + file_arguments(request_path, replies.files[-1].path)

        try:
            slots = self._pool.executor.slots
            shards = [
                Shard(indices, self._held.path, self._pool.executor.workers_per_machine)
                for indices in split_evenly(range(len(items)), slots, max(-(-len(items) // slots), 1))
            ]
            for missing_count in run_shards(self._pool, self._held, shards, replies, command, self._items_name):
                yield Progress(1.0 - missing_count / max(len(items), 1), label)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        return [replies.by_index[index] for index in range(len(items))]


class _ReplyFile:
    """The file in which a worker replies to the items with these indices, and how far it has been read."""

    def __init__(self, path: Path, indices: list[int]) -> None:
        self.path, self.indices = path, indices
        self._position, self._count = 0, 0

    def read_new(self) -> dict[int, Any]:
        """Return the replies since the last call by the index of their item. The last line may be incomplete."""
        if self._count == len(self.indices):
            return {}
        try:
            with self.path.open("rb") as stream:
                stream.seek(self._position)
                content = stream.read()
        except OSError:  # does not exist yet
            return {}
        lines = content.split(b"\n")[:-1]
        indices = self.indices[self._count : self._count + len(lines)]
        self._position += sum(len(line) + 1 for line in lines)
        self._count += len(lines)
        return {index: read_reply(line) for index, line in zip(indices, lines, strict=True)}


class _Replies:
    """The replies so far by the index of their item; `ItemFiles` of the indices."""

    parts = 1

    def __init__(self) -> None:
        self.files: list[_ReplyFile] = []
        self.by_index: dict[int, Any] = {}

    def validate_or_remove(self, index: int) -> bool:
        return index in self.by_index

    def count_parts(self, indices: Sequence[int]) -> list[int]:
        """Return 1 for each of `indices` that has a reply. Raises FarfieldError if one is an error."""
        for file in self.files:
            self.by_index |= file.read_new()
        return [int(index in self.by_index) for index in indices]
