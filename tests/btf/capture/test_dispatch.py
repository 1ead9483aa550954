"""Shards reach workers, finished views are reused, and failing or crashing workers are handled. The workers here are short scripts."""

import os
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.btf.capture.capture_run import MAX_SHARD_VIEWS, render_missing_views, split_views
from farfield.addon.core.btf.capture.shards import ShardStore
from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.jobs import heartbeat
from farfield.addon.core.jobs.executors import parse_executor
from farfield.addon.core.jobs.progress import run_to_end
from lib import environment

WORKER = f"""
import os, sys, time, types
sys.path.insert(0, {str(environment.ROOT / "scripts")!r})
from lib import environment
environment.import_farfield()
for tool in ("billboards", "btf"):  # Without what these packages export, and SciPy: importing it takes longer than everything else.
    package = sys.modules["farfield.addon.core." + tool] = types.ModuleType(tool)
    package.__path__ = [str(environment.ROOT / "addon" / "core" / tool)]
import numpy as np
from pathlib import Path
from farfield.addon.core.jobs import heartbeat
from farfield.addon.core.btf.capture.shards import ShardStore
from farfield.addon.core.jobs.core_worker import EXIT_ERROR, encode_error
from farfield.addon.core.btf.capture.observations import Observation, ReferenceImage
from farfield.addon.core.errors import FileError

reference = ReferenceImage(np.ones((5, 4, 4, 3), np.float32), np.ones((4, 4), np.float32))

def render(view):
    rng = np.random.default_rng(view)
    known = rng.random(50) > 0.5
    return Observation(known, rng.random(50).astype(np.float32), np.flatnonzero(known).astype(np.int32),
                       np.full(known.sum(), 9, np.uint8), rng.random((2, known.sum(), 3)).astype(np.float32))

folder, heartbeat_file, fault, *views = sys.argv[1:]
heartbeat.watch(Path(heartbeat_file), lambda: os._exit(3))
log = open(Path(folder) / "log", "a")
print("start", os.getpid(), *views, file=log, flush=True)
for view in map(int, views):
    for level in (0, 1):
        store = ShardStore(Path(folder) / f"level-{{level}}")
        if store.exists(view):
            continue
        exec(fault)
        store.write(view, render(view), reference, [], 0.25)
        print("view", level, view, file=log, flush=True)
"""
VIEWS = 6
CRASH_ONCE = "if view == 3 and not os.path.exists(folder + '/crashed'): open(folder + '/crashed', 'w'); os.kill(os.getpid(), 9)"
CRASH = "if view == 3: os.kill(os.getpid(), 9)"
FAIL = "if view == 3: print(encode_error(FileError('Kein Platz für „Ansicht 3“.')), file=sys.stderr); sys.exit(EXIT_ERROR)"
RAISE = "if view == 3: raise ZeroDivisionError('Null ist null.')"
EXHAUST = "if view == 3: raise MemoryError"
HANG = "if view == 3: open(folder + '/hangs', 'w'); time.sleep(600)"

pytestmark = [
    pytest.mark.once,
    pytest.mark.skipif(os.name == "nt", reason="the workers here kill themselves with a signal"),
]


class Bake:
    """A bake of two levels in a folder, with workers that have a fault."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.stores = [ShardStore(folder / f"level-{level}") for level in (0, 1)]
        for store in self.stores:
            store.open("this bake")

    def steps(self, word: str = "serial", fault: str = "pass"):
        def command(shard):
            return [sys.executable, "-c", WORKER, str(self.folder), str(shard.heartbeat_file), fault, *map(str, shard.items)]

        with closing(heartbeat.take_over(self.folder)) as held:
            return (yield from render_missing_views(held, self.stores, VIEWS, parse_executor(word), command))

    def log(self, keyword: str) -> list[str]:
        """Return the log lines that start with `keyword`, without it."""
        lines = (self.folder / "log").read_text().splitlines() if (self.folder / "log").exists() else []
        return [line.removeprefix(keyword + " ") for line in lines if line.startswith(keyword + " ")]

    def read_views(self) -> list[bytes]:
        return [store.path(view).read_bytes() for store in self.stores for view in range(VIEWS)]


@pytest.fixture
def bake(tmp_path):
    return Bake(tmp_path / "bake")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> list[bytes]:
    """Return the view files of an undisturbed bake."""
    bake = Bake(tmp_path_factory.mktemp("undisturbed"))
    assert run_to_end(bake.steps()) == 2 * VIEWS
    return bake.read_views()


@given(st.lists(st.integers(0, 2000), unique=True, min_size=1, max_size=300).map(sorted), st.integers(1, 40))
def test_split_views_covers_all_views_in_order_and_uses_all_slots(missing, slots):
    shards = split_views(missing, slots)
    assert [view for views in shards for view in views] == missing
    lengths = [len(views) for views in shards]
    assert min(lengths) >= 1 and max(lengths) <= min(min(lengths) + 1, MAX_SHARD_VIEWS)
    assert len(shards) == len(missing) or len(shards) % slots == 0


@pytest.mark.slow
@pytest.mark.parametrize("word", [pytest.param("serial", marks=pytest.mark.exhaustive), "processes:2"])
def test_every_view_is_rendered_once(bake, undisturbed, word):
    fractions = []
    assert run_to_end(bake.steps(word), lambda step: fractions.append(step.fraction)) == 2 * VIEWS
    assert sorted(bake.log("view")) == sorted(f"{level} {view}" for level in (0, 1) for view in range(VIEWS))
    assert len(bake.log("start")) == (1 if word == "serial" else 2)
    assert bake.read_views() == undisturbed
    assert fractions == sorted(fractions) and fractions[0] >= 0.0 and fractions[-1] <= 1.0
    assert sum(store.render_seconds(VIEWS) for store in bake.stores) == pytest.approx(0.25 * 2 * VIEWS)


def test_a_finished_bake_starts_no_worker(bake):
    run_to_end(bake.steps())
    started = bake.log("start")
    assert run_to_end(bake.steps()) == 0
    assert bake.log("start") == started


@pytest.mark.slow
def test_only_damaged_and_missing_views_are_rendered_again(bake, undisturbed):
    run_to_end(bake.steps())
    damaged = bytearray(bake.stores[1].path(4).read_bytes())
    damaged[-40] ^= 1
    bake.stores[1].path(4).write_bytes(damaged)
    bake.stores[0].path(2).unlink()
    temporary_file = bake.stores[0].folder / "view-0002.4711.part"
    temporary_file.write_bytes(b"half")
    (bake.folder / "log").unlink()
    assert run_to_end(bake.steps()) == 2
    assert sorted(bake.log("view")) == ["0 2", "1 4"]
    assert bake.read_views() == undisturbed and not temporary_file.exists()


@pytest.mark.slow
def test_the_remaining_views_of_a_crashed_worker_are_retried(bake, undisturbed):
    assert run_to_end(bake.steps(fault=CRASH_ONCE)) == 2 * VIEWS
    first, second = (line.split()[1:] for line in bake.log("start"))
    assert first == ["0", "1", "2", "3", "4", "5"] and second == ["3", "4", "5"]
    assert len(bake.log("view")) == len(set(bake.log("view"))) == 2 * VIEWS
    assert bake.read_views() == undisturbed


@pytest.mark.slow
def test_a_second_crash_ends_the_bake_and_keeps_finished_views(bake, undisturbed):
    with pytest.raises(FarfieldError, match=r"crashed twice at the same views \(killed by signal 9\).*resume with fewer processes"):
        run_to_end(bake.steps(fault=CRASH))
    assert [bake.stores[0].exists(view) for view in range(VIEWS)] == [True] * 3 + [False] * 3
    assert run_to_end(bake.steps()) == 6
    assert bake.read_views() == undisturbed


@pytest.mark.slow
def test_the_error_message_of_a_worker_is_passed_on_unchanged(bake):
    with pytest.raises(FarfieldError) as raised:
        run_to_end(bake.steps("serial", FAIL))
    assert str(raised.value) == "Kein Platz für „Ansicht 3“."
    assert bake.stores[0].exists(0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [(RAISE, RuntimeError, "in a worker process, ZeroDivisionError: Null ist null"), (EXHAUST, FarfieldError, "ran out of memory")],
)
def test_an_exception_in_a_worker_is_passed_on_without_a_retry(bake, fault, error, message):
    """A log of defects contains the notes of an exception, and so the traceback of the worker."""
    with pytest.raises(error, match=message) as raised:
        run_to_end(bake.steps("serial", fault))
    assert error is FarfieldError or "Traceback" in "".join(raised.value.__notes__)
    assert len(bake.log("start")) == 1
    assert [bake.stores[0].exists(view) for view in range(VIEWS)] == [True] * 3 + [False] * 3


@pytest.mark.slow
def test_cancelling_ends_the_workers_and_keeps_finished_views(bake, undisturbed):
    steps = bake.steps(fault=HANG)
    started = time.monotonic()
    for _ in steps:
        assert time.monotonic() - started < 60.0
        if (bake.folder / "hangs").exists():
            break
    steps.close()
    worker = int(bake.log("start")[0].split()[0])
    with pytest.raises(ProcessLookupError):  # this process, its parent, has waited for it
        os.kill(worker, 0)
    assert not list(bake.folder.glob(f"*{heartbeat.FILE_SUFFIX}"))
    assert [bake.stores[0].exists(view) for view in range(VIEWS)] == [True] * 3 + [False] * 3
    run_to_end(bake.steps())
    assert bake.read_views() == undisturbed


@pytest.mark.slow
def test_a_later_run_in_the_same_folder_takes_over(bake, undisturbed):
    first = bake.steps(fault=HANG)
    for _ in first:
        if (bake.folder / "hangs").exists():
            break
    assert run_to_end(bake.steps()) == 6
    with pytest.raises(FileError, match="Another run has started"):
        run_to_end(first)
    assert bake.read_views() == undisturbed
