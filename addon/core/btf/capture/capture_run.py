"""One run of a bake in its work folder: the snapshot for its workers and its heartbeat end with it, its finished views stay.

Views are dispatched to worker processes in shards.
"""

import shutil
import time
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ...files.file_access import convert_os_errors
from ...files.user_folders import open_private_folder
from ...jobs import dispatch, heartbeat
from ...jobs.executors import Executor
from ...jobs.heartbeat import Heartbeat
from ...jobs.progress import Steps
from .shards import ShardStore

SNAPSHOT_SUFFIX = ".snapshot"
MAX_AGE_DAYS = 30.0  # Age at which the finished views of a cancelled bake are deleted.
SECONDS_PER_DAY = 86400.0
MAX_SHARD_VIEWS = 64  # Per worker process: Blender's memory grows slowly with the number of renders.
VIEWS = dispatch.ItemName("view", "views")


class CaptureRun:
    """The run that writes to `folder`. From its creation until `close`, no other run does.

    snapshot_folder: a folder of this run for its snapshot, that only this user can read. It and the heartbeat file are deleted by `close`,
    when the object is deleted, or at the end of the process.

    Raises:
        FileError: the folder cannot be written, or another run starts there at the same time.
    """

    def __init__(self, folder: Path) -> None:
        self.heartbeat = heartbeat.take_over(folder)
        self.snapshot_folder = self.heartbeat.path.with_suffix(SNAPSHOT_SUFFIX)
        self._finalizer = weakref.finalize(self, _end_run, self.heartbeat, self.snapshot_folder)
        _delete_snapshots(folder)
        with convert_os_errors(f'Cannot write in the folder "{folder}"'):
            open_private_folder(self.snapshot_folder)

    def close(self) -> None:
        """End the run."""
        self._finalizer()


def remove_expired(cache: Path) -> None:
    """Delete the work folders in `cache` that no run has used for MAX_AGE_DAYS, and the snapshots of runs that were killed.

    Folders of current runs are untouched, and so are those that cannot be deleted.
    """
    with suppress(OSError):
        for folder in cache.iterdir():
            if folder.is_symlink() or not folder.is_dir() or heartbeat.is_alive(folder):
                continue
            times = [folder.stat().st_mtime, *(child.stat().st_mtime for child in folder.iterdir())]
            if time.time() - max(times) > MAX_AGE_DAYS * SECONDS_PER_DAY:
                shutil.rmtree(folder, ignore_errors=True)
            else:
                _delete_snapshots(folder)


def _end_run(held: heartbeat.Heartbeat, snapshot_folder: Path) -> None:
    shutil.rmtree(snapshot_folder, ignore_errors=True)
    held.close()


def _delete_snapshots(folder: Path) -> None:
    """Delete the snapshots of earlier runs."""
    for path in folder.glob(f"*{SNAPSHOT_SUFFIX}"):
        shutil.rmtree(path, ignore_errors=True)


def render_missing_views(
    held: Heartbeat, stores: Sequence[ShardStore], view_count: int, executor: Executor, command: Callable[[dispatch.Shard[int]], list[str]]
) -> Steps[int]:
    """Have worker processes render all views that are missing in any of the `stores`; return their number.

    held: of the run, which must own the folders of all stores. command: returns the command line that renders a shard for all stores; it
    must skip finished views. See `jobs.dispatch.run_missing` for the other arguments and the errors.
    """
    for store in stores:
        store.remove_temporary_files()
    files = _ViewFiles(stores)
    return (yield from dispatch.run_missing(held, range(view_count), files, executor, command, VIEWS, split_views))


def split_views(missing: Sequence[int], slots: int) -> list[list[int]]:
    """Split the `missing` views into runs of nearly equal length: one per slot, or a multiple of that with at most MAX_SHARD_VIEWS each."""
    return dispatch.split_evenly(missing, slots, MAX_SHARD_VIEWS)


@dataclass(frozen=True)
class _ViewFiles:
    """A view has one file per store."""

    stores: Sequence[ShardStore]

    @property
    def parts(self) -> int:
        return len(self.stores)

    def validate_or_remove(self, view: int) -> bool:
        is_valid = [store.validate_or_remove(view) for store in self.stores]  # A list: every damaged file is removed.
        return all(is_valid)

    def count_parts(self, views: Sequence[int]) -> list[int]:
        return [sum(store.exists(view) for store in self.stores) for view in views]
