"""The views of a bake handed out to worker processes in shards, and handed out again when a worker dies."""

import json
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import lease
from ..commands import open_commands, outcome
from ..errors import FarfieldError
from ..progress import Progress, Steps
from .shards import ShardStore

LOOK = 0.1  # seconds between two looks at the folder
REFUSED = 2  # exit code of a worker that has said why
REFUSAL = "farfield_refusal"  # key of the JSON line on its stderr that says it
SHARD_VIEWS = 64  # of one worker process at most: Blender's memory creeps up with the renders
CHECKED = 0.02  # of the bar


@dataclass(frozen=True)
class Shard:
    """A run of views for one worker process. lease: the file that it watches. sharing: how many workers share its machine."""

    views: list[int]
    lease: Path
    sharing: int


def refusal(error: FarfieldError) -> str:
    """The line with which a worker says why it ends with the code REFUSED. All of it is ASCII, whatever the machine's encoding."""
    return json.dumps({REFUSAL: str(error)})


def render_missing(folder: Path, stores: Sequence[ShardStore], views: int, word: str, command: Callable[[Shard], list[str]]) -> Steps[int]:
    """Have every missing one of the `views` of all `stores` below `folder` rendered by worker processes; returns how many were.

    word: the executor's, see `parallel.read_word`. command: the command line that renders a shard, for all stores, leaving out what stands.
    Whoever closes these steps ends the workers; what they have finished stays.

    Raises:
        SettingsError, FarfieldError: when there is no such executor, a worker refuses, or one and its successor die.
        FileError: when the folder cannot be written or another run takes it over.
    """
    with lease.held(folder) as held:  # from here on nobody else writes in the folder
        missing = []
        for store in stores:
            store.remove_parts()
        for view in range(views):
            yield Progress(CHECKED * view / views, "Looking for finished views")
            standing_in = [store.keeps(view) for store in stores]  # of all, so that every damaged file is removed
            if not all(standing_in):
                missing.append(view)
        if not missing:
            return 0
        standing = _finished(stores, views)
        with open_commands(word) as commands:
            shards = [Shard(part, held.path, commands.spread.sharing) for part in runs_of(missing, commands.spread.slots)]
            pending = {commands.submit(command(shard)): (shard, False) for shard in shards}
            while pending:
                held.renew()
                finished = _finished(stores, views)
                share = (finished - standing) / (views * len(stores) - standing)
                yield Progress(CHECKED + (1.0 - CHECKED) * share, f"View {finished} of {views * len(stores)}")
                for done in wait(pending, LOOK, FIRST_COMPLETED).done:
                    shard, again = pending.pop(done)
                    code, words = outcome(done)
                    held.renew()  # first of all: workers also end because another run took over
                    rest = [view for view in shard.views if not all(store.has(view) for store in stores)]
                    if code == REFUSED or (rest and again):
                        raise FarfieldError(_why(code, words))
                    if rest:
                        successor = Shard(rest, shard.lease, shard.sharing)
                        pending[commands.submit(command(successor))] = successor, True
        return _finished(stores, views) - standing


def runs_of(missing: Sequence[int], slots: int) -> list[list[int]]:
    """`missing` views in runs of about equal length, each view in one: one run a slot, or several where runs would be too long."""
    count = -(-len(missing) // SHARD_VIEWS)
    count = min(len(missing), -(-count // slots) * slots)
    return [part.tolist() for part in np.array_split(np.array(missing, np.int64), count)]


def _finished(stores: Sequence[ShardStore], views: int) -> int:
    return sum(store.has(view) for store in stores for view in range(views))


def _why(code: int, words: str) -> str:
    """The sentence of a worker that has refused, else what is known of one that died."""
    lines = [line.strip() for line in words.splitlines() if line.strip()]
    if code == REFUSED:
        for line in reversed(lines):
            if line.startswith("{") and REFUSAL in line:
                return json.loads(line)[REFUSAL]
    how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    last = f'; its last words: "{lines[-1]}"' if lines else ""
    return (
        f"A worker process died twice at the same views ({how}{last}); perhaps memory ran out. Views that are finished are kept: "
        "resume with fewer processes."
    )
