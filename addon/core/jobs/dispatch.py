"""Dispatch of many items to worker processes in shards, with one retry when a worker crashes. Results are files."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from ..errors import FarfieldError
from .core_worker import EXIT_ERROR, EXIT_EXCEPTION, failure_message, worker_exception
from .executors import Executor
from .heartbeat import Heartbeat
from .progress import Progress, Steps
from .subprocess_pool import SubprocessPool, wait_for_exit

POLL_SECONDS = 0.1  # between two progress updates
CHECK_FRACTION = 0.02  # Part of the progress bar that the check of finished items takes.

Item = TypeVar("Item")


@dataclass(frozen=True)
class Shard(Generic[Item]):
    """Items for one worker process. heartbeat_file: the file that it watches. workers_per_machine: how many workers use its machine."""

    items: list[Item]
    heartbeat_file: Path
    workers_per_machine: int


@dataclass(frozen=True)
class ItemName:
    """What progress and error messages call the items: "view" and "views"."""

    singular: str
    plural: str


class ItemFiles(Protocol[Item]):
    """The files that show which items are finished. parts: how many files an item has."""

    parts: int

    def validate_or_remove(self, item: Item) -> bool:
        """Return whether an item is finished and undamaged. Damaged files are deleted, so that they do not count from then on."""

    def count_parts(self, items: Sequence[Item]) -> list[int]:
        """Return how many files of each of `items` exist. Called often."""


def run_missing(
    held: Heartbeat,
    items: Sequence[Item],
    files: ItemFiles[Item],
    executor: Executor,
    command: Callable[[Shard[Item]], list[str]],
    name: ItemName,
    split: Callable[[Sequence[Item], int], list[list[Item]]],
) -> Steps[int]:
    """Have worker processes finish all `items` that miss files; return the number of new files.

    held: of the run, which must own the folders of the files. command: returns the command line that finishes a shard; it must skip
    finished files. split: splits the missing items into shards for a number of slots, see `split_evenly`. Closing this generator ends the
    workers; finished items are kept.

    Raises:
        FarfieldError: a worker reports an error, runs out of memory, or crashes twice at the same items.
        RuntimeError: a worker fails with another exception. A second worker would fail in the same way.
        FileError: a folder cannot be written, or another run takes it over.
    """
    missing = []
    for index, item in enumerate(items):
        held.renew()
        yield Progress(CHECK_FRACTION * index / len(items), f"Looking for finished {name.plural}")
        if not files.validate_or_remove(item):
            missing.append(item)
    if not missing:
        return 0
    total = files.parts * len(items)
    finished_before = total - files.parts * len(missing) + sum(files.count_parts(missing))
    with executor.open_subprocess_pool() as pool:
        shards = [Shard(part, held.path, pool.workers_per_machine) for part in split(missing, pool.slots)]
        finished = finished_before
        for missing_parts in run_shards(pool, held, shards, files, command, name.plural):
            finished = total - missing_parts
            fraction = (finished - finished_before) / (total - finished_before)
            yield Progress(CHECK_FRACTION + (1.0 - CHECK_FRACTION) * fraction, f"{name.singular.capitalize()} {finished} of {total}")
    return total - finished_before


def run_shards(
    pool: SubprocessPool,
    held: Heartbeat,
    shards: Sequence[Shard[Item]],
    files: ItemFiles[Item],
    command: Callable[[Shard[Item]], list[str]],
    items_name: str,
) -> Generator[int, None, None]:
    """Run each shard in a subprocess of `pool`; yield how many files its items still miss, every POLL_SECONDS and at the end.

    The remaining items of a worker that crashes are given to another one. Raises as `run_missing`.
    """
    unfinished = [item for shard in shards for item in shard.items]
    pending = {pool.submit(command(shard)): (shard, False) for shard in shards}
    while pending:
        held.renew()
        counts = files.count_parts(unfinished)
        yield files.parts * len(unfinished) - sum(counts)
        unfinished = _select_unfinished(unfinished, counts, files.parts)
        for future in wait(pending, POLL_SECONDS, FIRST_COMPLETED).done:
            shard, is_retry = pending.pop(future)
            code, error_output = wait_for_exit(future)
            held.renew()  # first: workers also exit when another run has taken over
            remaining = _select_unfinished(shard.items, files.count_parts(shard.items), files.parts)
            if remaining and code == EXIT_EXCEPTION:
                raise worker_exception(error_output, items_name)
            if code == EXIT_ERROR or (remaining and is_retry):
                raise FarfieldError(failure_message(code, error_output, items_name))
            if remaining:
                retry = Shard(remaining, shard.heartbeat_file, shard.workers_per_machine)
                pending[pool.submit(command(retry))] = retry, True
    yield 0


def split_evenly(items: Sequence[Item], slots: int, max_items: int) -> list[list[Item]]:
    """Split `items` into runs of nearly equal length: one per slot, or a multiple of that with at most `max_items` each."""
    if not items:
        return []
    count = -(-len(items) // max_items)
    count = min(len(items), -(-count // slots) * slots)
    length, longer_count = divmod(len(items), count)
    starts = [length * index + min(index, longer_count) for index in range(count + 1)]
    return [list(items[start:stop]) for start, stop in pairwise(starts)]


def _select_unfinished(items: Sequence[Item], counts: Sequence[int], parts: int) -> list[Item]:
    return [item for item, count in zip(items, counts, strict=True) if count < parts]
