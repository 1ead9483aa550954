"""Shards reach workers, views that stand are left alone, and workers that refuse or die are dealt with. Workers are a few lines here."""

import os
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import environment
from farfield.addon.core import lease
from farfield.addon.core.btf.shards import ShardStore
from farfield.addon.core.btf.spreading import SHARD_VIEWS, render_missing, runs_of
from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.progress import finish

WORKER = f"""
import os, sys, time
sys.path.insert(0, {str(environment.ROOT / "scripts")!r})
import environment
environment.import_farfield()
import numpy as np
from pathlib import Path
from farfield.addon.core import lease
from farfield.addon.core.btf.shards import ShardStore
from farfield.addon.core.btf.spreading import REFUSED, refusal
from farfield.addon.core.btf.photographs import Photograph
from farfield.addon.core.btf.texels import Sighting
from farfield.addon.core.errors import FileError

photograph = Photograph(np.ones((5, 4, 4, 3), np.float32), np.ones((4, 4), np.float32))

def render(view):
    rng = np.random.default_rng(view)
    known = rng.random(50) > 0.5
    return Sighting(known, rng.random(50).astype(np.float32), np.flatnonzero(known).astype(np.int32), np.full(known.sum(), 9, np.uint8),
                    rng.random((2, known.sum(), 3)).astype(np.float32))

folder, watched, harm, *views = sys.argv[1:]
lease.watch(Path(watched), lambda: os._exit(3))
log = open(Path(folder) / "log", "a")
print("start", os.getpid(), *views, file=log, flush=True)
for view in map(int, views):
    for level in (0, 1):
        store = ShardStore(Path(folder) / f"level-{{level}}")
        if store.has(view):
            continue
        exec(harm)
        store.write(view, render(view), photograph, [], 0.25)
        print("view", level, view, file=log, flush=True)
"""
VIEWS = 6
DIE_ONCE = "if view == 3 and not os.path.exists(folder + '/died'): open(folder + '/died', 'w'); os.kill(os.getpid(), 9)"
DIE = "if view == 3: os.kill(os.getpid(), 9)"
REFUSE = "if view == 3: print(refusal(FileError('Kein Platz für „Ansicht 3“.')), file=sys.stderr); sys.exit(REFUSED)"
HANG = "if view == 3: open(folder + '/hangs', 'w'); time.sleep(600)"

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the workers here kill themselves with a signal")


class Bake:
    """Two levels in a folder, and workers that come to some harm."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.stores = [ShardStore(folder / f"level-{level}") for level in (0, 1)]
        for store in self.stores:
            store.open("this bake")

    def steps(self, word: str = "serial", harm: str = "pass"):
        def command(shard):
            return [sys.executable, "-c", WORKER, str(self.folder), str(shard.lease), harm, *map(str, shard.views)]

        return render_missing(self.folder, self.stores, VIEWS, word, command)

    def log(self, first: str) -> list[str]:
        """The lines of the workers that begin so, without their beginning."""
        lines = (self.folder / "log").read_text().splitlines() if (self.folder / "log").exists() else []
        return [line.removeprefix(first + " ") for line in lines if line.startswith(first + " ")]

    def bytes(self) -> list[bytes]:
        return [store.path(view).read_bytes() for store in self.stores for view in range(VIEWS)]


@pytest.fixture
def bake(tmp_path):
    return Bake(tmp_path / "bake")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> list[bytes]:
    """The files of a bake that nothing happened to."""
    whole = Bake(tmp_path_factory.mktemp("whole"))
    assert finish(whole.steps()) == 2 * VIEWS
    return whole.bytes()


@given(st.lists(st.integers(0, 2000), unique=True, min_size=1, max_size=300).map(sorted), st.integers(1, 40))
def test_runs_hold_every_view_once_in_order_and_keep_all_slots_busy(missing, slots):
    runs = runs_of(missing, slots)
    assert [view for run in runs for view in run] == missing
    lengths = [len(run) for run in runs]
    assert min(lengths) >= 1 and max(lengths) <= min(min(lengths) + 1, SHARD_VIEWS)
    assert len(runs) == len(missing) or len(runs) % slots == 0


@pytest.mark.parametrize("word", ["serial", "processes:2"])
def test_every_view_is_rendered_once(bake, undisturbed, word):
    fractions = []
    assert finish(bake.steps(word), lambda step: fractions.append(step.fraction)) == 2 * VIEWS
    assert sorted(bake.log("view")) == sorted(f"{level} {view}" for level in (0, 1) for view in range(VIEWS))
    assert len(bake.log("start")) == (1 if word == "serial" else 2)
    assert bake.bytes() == undisturbed
    assert fractions == sorted(fractions) and fractions[0] >= 0.0 and fractions[-1] <= 1.0
    assert sum(store.render_seconds(VIEWS) for store in bake.stores) == pytest.approx(0.25 * 2 * VIEWS)


def test_a_bake_that_is_done_starts_no_worker(bake):
    finish(bake.steps())
    started = bake.log("start")
    assert finish(bake.steps()) == 0
    assert bake.log("start") == started


def test_damaged_and_unfinished_files_are_made_anew_and_nothing_else(bake, undisturbed):
    finish(bake.steps())
    damaged = bytearray(bake.stores[1].path(4).read_bytes())
    damaged[-40] ^= 1
    bake.stores[1].path(4).write_bytes(damaged)
    bake.stores[0].path(2).unlink()
    part = bake.stores[0].folder / "view-0002.4711.part"
    part.write_bytes(b"half")
    (bake.folder / "log").unlink()
    assert finish(bake.steps()) == 2
    assert sorted(bake.log("view")) == ["0 2", "1 4"]
    assert bake.bytes() == undisturbed and not part.exists()


def test_a_worker_that_dies_has_a_successor_for_what_it_left(bake, undisturbed):
    assert finish(bake.steps(harm=DIE_ONCE)) == 2 * VIEWS
    first, second = (line.split()[1:] for line in bake.log("start"))
    assert first == ["0", "1", "2", "3", "4", "5"] and second == ["3", "4", "5"]
    assert len(bake.log("view")) == len(set(bake.log("view"))) == 2 * VIEWS
    assert bake.bytes() == undisturbed


def test_a_second_death_is_one_sentence_and_views_stand(bake, undisturbed):
    with pytest.raises(FarfieldError, match=r"died twice at the same views \(killed by signal 9\).*resume with fewer processes"):
        finish(bake.steps(harm=DIE))
    assert [bake.stores[0].has(view) for view in range(VIEWS)] == [True] * 3 + [False] * 3
    assert finish(bake.steps()) == 6
    assert bake.bytes() == undisturbed


def test_a_refusal_reaches_the_user_word_for_word(bake):
    with pytest.raises(FarfieldError) as refused:
        finish(bake.steps("serial", REFUSE))
    assert str(refused.value) == "Kein Platz für „Ansicht 3“."
    assert bake.stores[0].has(0)


def test_whoever_stops_ends_the_workers_and_keeps_the_views(bake, undisturbed):
    steps = bake.steps(harm=HANG)
    started = time.monotonic()
    for _ in steps:
        assert time.monotonic() - started < 60.0
        if (bake.folder / "hangs").exists():
            break
    steps.close()
    worker = int(bake.log("start")[0].split()[0])
    with pytest.raises(ProcessLookupError):  # its parent, which is this process, has seen it end
        os.kill(worker, 0)
    assert not list(bake.folder.glob(f"*{lease.ENDING}"))
    assert [bake.stores[0].has(view) for view in range(VIEWS)] == [True] * 3 + [False] * 3
    finish(bake.steps())
    assert bake.bytes() == undisturbed


def test_of_two_runs_in_one_folder_the_later_one_goes_on(bake, undisturbed):
    first = bake.steps(harm=HANG)
    for _ in first:
        if (bake.folder / "hangs").exists():
            break
    assert finish(bake.steps()) == 6
    with pytest.raises(FileError, match="Another run has begun"):
        finish(first)
    assert bake.bytes() == undisturbed
