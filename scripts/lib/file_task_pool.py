"""A task pool of worker processes that read their items from files and reply in files, for machines that share a folder."""

import json
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lib import environment

environment.import_farfield()

from farfield.addon.core.files.file_access import convert_os_errors
from farfield.addon.core.jobs.dispatch import Shard, run_shards, split_evenly
from farfield.addon.core.jobs.heartbeat import Heartbeat
from farfield.addon.core.jobs.progress import Progress, Steps
from farfield.addon.core.jobs.subprocess_pool import SubprocessPool
from farfield.addon.core.jobs.task_worker import file_arguments, read_reply


class FileTaskPool:
    """Gives items to subprocesses of `pool` that run `command`, through files in `folder`; see `task_pool.TaskPool`."""

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
            slots = self._pool.slots
            shards = [
                Shard(indices, self._held.path, self._pool.workers_per_machine)
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
