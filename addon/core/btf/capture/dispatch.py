"""Dispatch of a bake's views to worker processes in shards."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ...jobs import dispatch
from ...jobs.heartbeat import Heartbeat
from ...jobs.progress import Steps
from .shards import ShardStore

MAX_SHARD_VIEWS = 64  # Per worker process: Blender's memory grows slowly with the number of renders.
VIEWS = dispatch.ItemName("view", "views")


def render_missing_views(
    held: Heartbeat, stores: Sequence[ShardStore], view_count: int, executor_spec: str, command: Callable[[dispatch.Shard[int]], list[str]]
) -> Steps[int]:
    """Have worker processes render all views that are missing in any of the `stores`; return their number.

    held: of the run, which must own the folders of all stores. command: returns the command line that renders a shard for all stores; it
    must skip finished views. See `jobs.dispatch.run_missing` for the other arguments and the errors.
    """
    for store in stores:
        store.remove_temporary_files()
    files = _ViewFiles(stores)
    return (yield from dispatch.run_missing(held, range(view_count), files, executor_spec, command, VIEWS, split_views))


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
