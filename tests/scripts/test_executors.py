"""Scripts open executors by words. On a Dask scheduler, commands run, and task pools give the same replies as serial ones, survive one
crash, and end with their run.

The tests use one scheduler: the first one before it has workers, the last one ends it.
"""

import os
import sys
import time
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from dask_farm import DaskFarm
from farfield.addon.core.errors import FarfieldError, SettingsError
from farfield.addon.core.jobs import heartbeat
from farfield.addon.core.jobs.executors import LocalExecutor
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.jobs.subprocess_pool import wait_for_exit
from lib import executors
from lib.executors import open_executor

pytestmark = pytest.mark.once
MODULE = "tests.jobs.sample_tasks"


@contextmanager
def open_pool(folder: Path, word: str, task: str):
    with (
        closing(heartbeat.take_over(folder)) as held,
        open_executor(word) as executor,
        executor.open_task_pool(MODULE, [task, str(folder)], held, "tiles") as pool,
    ):
        yield pool


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """A scheduler without workers."""
    pytest.importorskip("distributed")
    farm = DaskFarm(tmp_path_factory.mktemp("farm"))
    yield farm
    farm.close()


@pytest.fixture(scope="module")
def farm(scheduler):
    """The scheduler with two workers."""
    scheduler.start_workers(2)
    return scheduler


def test_words_of_the_extension_open_its_executors():
    with open_executor("serial") as serial, open_executor("processes:3") as several:
        assert (serial, several) == (LocalExecutor(1, is_serial=True), LocalExecutor(3))


@pytest.mark.parametrize("word", ["dask", "dask:", "dask:localhost", "dask:no://h:1", "threads"])
def test_other_words_are_rejected(word):
    with pytest.raises(SettingsError, match="Executor must be"), open_executor(word):
        pass


def test_a_scheduler_without_dask_installed_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(FarfieldError, match="Dask is not installed"), open_executor("dask:tcp://127.0.0.1:9"):
        pass


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "CONNECT_SECONDS", 0.1)
    timeout = pytest.raises(FarfieldError, match=r"No Dask scheduler answers at .tcp://127\.0\.0\.1:9")
    with timeout, open_executor("dask:tcp://127.0.0.1:9"):
        pass


@pytest.mark.slow
def test_a_scheduler_without_workers_is_rejected(scheduler):
    with pytest.raises(FarfieldError, match="has no workers"), open_executor(f"dask:{scheduler.address}"):
        pass


@pytest.mark.slow
def test_a_scheduler_gives_the_replies_of_a_serial_run(farm, tmp_path):
    folder = tmp_path / "shared ü"
    folder.mkdir()
    items = [{"number": number, "text": "Höhe \udcff\n"} for number in range(15)]
    replies = []
    for spec in ("serial", f"dask:{farm.address}"):
        with open_pool(folder, spec, "describe") as pool:
            fractions = []
            replies.append(run_to_end(pool.run(items, "Tiles"), lambda step: fractions.append(step.fraction)))  # noqa: B023
            assert fractions == sorted(fractions)
            assert run_to_end(pool.run(items[:1], "Tiles")) == replies[0][:1]
            assert run_to_end(pool.run([], "Nothing")) == []
    assert replies[0] == replies[1]
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_crashes_and_errors_of_workers_on_a_scheduler(farm, tmp_path):
    spec, folder = f"dask:{farm.address}", tmp_path / "shared"
    folder.mkdir()
    with open_pool(folder, spec, "crash_once") as pool:
        assert run_to_end(pool.run([0, 1, 5, 2, 3, 4], "Tiles")) == [0, -1, -5, -2, -3, -4]
    assert len((folder / "calls").read_text().splitlines()) == 7, "replies before the crash are kept"
    with open_pool(folder, spec, "crash") as pool, pytest.raises(FarfieldError, match=r"crashed twice at the same tiles \("):
        run_to_end(pool.run(list(range(8)), "Tiles"))
    with open_pool(folder, spec, "fail") as pool, pytest.raises(FarfieldError, match=r"^Kein Platz für „Kachel 3“\.$"):
        run_to_end(pool.run(list(range(8)), "Tiles"))
    with open_pool(folder, spec, "refuse") as pool, pytest.raises(FarfieldError, match=r"^The tasks cannot be opened\.$"):
        run_to_end(pool.run(list(range(8)), "Tiles"))


@pytest.mark.skipif(os.name == "nt", reason="asks for a process by its number")
def test_workers_on_a_scheduler_end_with_their_run(farm, tmp_path):
    folder = tmp_path / "shared"
    folder.mkdir()
    started = time.monotonic()
    with open_pool(folder, f"dask:{farm.address}", "hang") as pool:
        steps = pool.run([1, 2], "Tiles")
        for _ in steps:
            assert time.monotonic() - started < 60.0
            if (folder / "hangs").exists() and (folder / "hangs").read_text():
                break
        steps.close()
    while any(map(is_running, (folder / "hangs").read_text().split())):
        assert time.monotonic() - started < 90.0, "a worker outlives its run"
        time.sleep(0.05)


def is_running(process: str) -> bool:
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return False
    return True


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_dask_runs_commands_without_farfield(farm):
    with open_executor(f"dask:{farm.address}") as executor, executor.open_subprocess_pool() as pool:
        assert (pool.slots, pool.workers_per_machine) == (2, 2)
        pending = [pool.submit(python(f"import sys; print({code}, file=sys.stderr); sys.exit({code})")) for code in range(4)]
        assert [wait_for_exit(future) for future in pending] == [(code, f"{code}\n") for code in range(4)]
        with pytest.raises(FarfieldError, match="cannot be started"):
            wait_for_exit(pool.submit(["no-such-program"]))


@pytest.mark.slow
def test_a_lost_scheduler_is_reported(farm):
    with open_executor(f"dask:{farm.address}") as executor, executor.open_subprocess_pool() as pool:
        pending = pool.submit(python("import time; time.sleep(20)"))
        time.sleep(0.5)
        farm.close()
        with pytest.raises(FarfieldError, match="stopped or dropped"):
            wait_for_exit(pending)
