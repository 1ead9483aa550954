"""Dispatch of a bake's views to worker processes in shards, with one retry when a worker crashes."""

import json
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FarfieldError
from ...jobs import heartbeat
from ...jobs.progress import Progress, Steps
from ...jobs.subprocess_pool import open_subprocess_pool, wait_for_exit
from .shards import ShardStore

POLL_SECONDS = 0.1  # between two progress updates
EXIT_EXCEPTION, EXIT_ERROR = 1, 2  # exit codes of a worker after any exception, and after it has printed an error message
ERROR_KEY = "farfield_error"  # key of the JSON line on stderr with that message
MAX_SHARD_VIEWS = 64  # per worker process: Blender's memory grows slowly with the number of renders
CHECK_FRACTION = 0.02  # of the progress bar


@dataclass(frozen=True)
class Shard:
    """Views for one worker process. heartbeat_file: the file that it watches. workers_per_machine: how many workers share its machine."""

    views: list[int]
    heartbeat_file: Path
    workers_per_machine: int


def encode_error(error: FarfieldError) -> str:
    """Return the line that a worker prints before it exits with EXIT_ERROR. ASCII only: stderr may have any encoding."""
    return json.dumps({ERROR_KEY: str(error)})


def render_missing_views(
    held: heartbeat.Heartbeat, stores: Sequence[ShardStore], view_count: int, executor_spec: str, command: Callable[[Shard], list[str]]
) -> Steps[int]:
    """Have worker processes render all views that are missing in any of the `stores`; return their number.

    held: of the run, which must own the folders of all stores. executor_spec: see `executors.parse_executor`. command: returns the command
    line that renders a shard for all stores; it must skip finished views. Closing this generator ends the workers; finished views are kept.

    Raises:
        SettingsError: the executor spec is invalid.
        FarfieldError: a worker reports an error, runs out of memory, or crashes twice at the same views.
        RuntimeError: a worker fails with another exception. A second worker would fail in the same way.
        FileError: a folder cannot be written, or another run takes it over.
    """
    missing = []
    for store in stores:
        store.remove_temporary_files()
    for view in range(view_count):
        held.renew()
        yield Progress(CHECK_FRACTION * view / view_count, "Looking for finished views")
        is_valid = [store.validate_or_remove(view) for store in stores]  # a list: every damaged file is removed
        if not all(is_valid):
            missing.append(view)
    if not missing:
        return 0
    count_before = _count_finished(stores, view_count)
    with open_subprocess_pool(executor_spec) as pool:
        shards = [Shard(views, held.path, pool.executor.workers_per_machine) for views in split_views(missing, pool.executor.slots)]
        pending = {pool.submit(command(shard)): (shard, False) for shard in shards}
        while pending:
            held.renew()
            finished = _count_finished(stores, view_count)
            fraction = (finished - count_before) / (view_count * len(stores) - count_before)
            yield Progress(CHECK_FRACTION + (1.0 - CHECK_FRACTION) * fraction, f"View {finished} of {view_count * len(stores)}")
            for future in wait(pending, POLL_SECONDS, FIRST_COMPLETED).done:
                shard, is_retry = pending.pop(future)
                code, error_output = wait_for_exit(future)
                held.renew()  # first: workers also exit when another run has taken over
                remaining = [view for view in shard.views if not all(store.exists(view) for store in stores)]
                if remaining and code == EXIT_EXCEPTION:
                    raise _worker_exception(error_output)
                if code == EXIT_ERROR or (remaining and is_retry):
                    raise FarfieldError(_failure_message(code, error_output))
                if remaining:
                    retry = Shard(remaining, shard.heartbeat_file, shard.workers_per_machine)
                    pending[pool.submit(command(retry))] = retry, True
    return _count_finished(stores, view_count) - count_before


def split_views(missing: Sequence[int], slots: int) -> list[list[int]]:
    """Split the `missing` views into runs of nearly equal length: one per slot, or a multiple of that with at most MAX_SHARD_VIEWS each."""
    count = -(-len(missing) // MAX_SHARD_VIEWS)
    count = min(len(missing), -(-count // slots) * slots)
    return [views.tolist() for views in np.array_split(np.array(missing, np.int64), count)]


def _count_finished(stores: Sequence[ShardStore], view_count: int) -> int:
    return sum(store.exists(view) for store in stores for view in range(view_count))


def _failure_message(code: int, error_output: str) -> str:
    """Return the error message that a worker has printed, or a description of its crash."""
    lines = [line.strip() for line in error_output.splitlines() if line.strip()]
    if code == EXIT_ERROR:
        for line in reversed(lines):
            if line.startswith("{") and ERROR_KEY in line:
                return json.loads(line)[ERROR_KEY]
    reason = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    last_output = f', last output: "{lines[-1]}"' if lines else ""
    return (
        f"A worker process crashed twice at the same views ({reason}{last_output}), perhaps because memory ran out. "
        "Finished views are kept; resume with fewer processes."
    )


def _worker_exception(error_output: str) -> Exception:
    """Return the exception with which a worker has failed; its traceback becomes a note for the log of defects."""
    lines = [line.strip() for line in error_output.splitlines() if line.strip()]
    last_output = lines[-1] if lines else "no output"
    if last_output.partition(":")[0].endswith("MemoryError"):
        return FarfieldError("A worker process ran out of memory; finished views are kept, so resume with fewer processes.")
    error = RuntimeError(f"in a worker process, {last_output}")
    error.add_note(error_output)
    return error
