"""Task pools on a Dask scheduler give the same replies as serial ones, survive one crash, and end with their run."""

import os
import time
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.jobs import heartbeat
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.jobs.task_pool import open_task_pool

MODULE = "tests.jobs.sample_tasks"


@contextmanager
def open_pool(folder: Path, executor_spec: str, task: str):
    with (
        closing(heartbeat.take_over(folder)) as held,
        open_task_pool(executor_spec, MODULE, [task, str(folder)], held, "tiles") as pool,
    ):
        yield pool


def test_a_scheduler_gives_the_replies_of_a_serial_run(scheduler, tmp_path):
    scheduler.start_workers(2)
    folder = tmp_path / "shared ü"
    folder.mkdir()
    items = [{"number": number, "text": "Höhe \udcff\n"} for number in range(15)]
    replies = []
    for spec in ("serial", f"dask:{scheduler.address}"):
        with open_pool(folder, spec, "describe") as pool:
            fractions = []
            replies.append(run_to_end(pool.run(items, "Tiles"), lambda step: fractions.append(step.fraction)))  # noqa: B023
            assert fractions == sorted(fractions)
            assert run_to_end(pool.run(items[:1], "Tiles")) == replies[0][:1]
            assert run_to_end(pool.run([], "Nothing")) == []
    assert replies[0] == replies[1]
    assert not list(folder.iterdir())


def test_crashes_and_errors_of_workers_on_a_scheduler(scheduler, tmp_path):
    scheduler.start_workers(2)
    spec, folder = f"dask:{scheduler.address}", tmp_path / "shared"
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
def test_workers_on_a_scheduler_end_with_their_run(scheduler, tmp_path):
    scheduler.start_workers(1)
    folder = tmp_path / "shared"
    folder.mkdir()
    started = time.monotonic()
    with open_pool(folder, f"dask:{scheduler.address}", "hang") as pool:
        steps = pool.run([1, 2], "Tiles")
        for _ in steps:
            assert time.monotonic() - started < 60.0
            if (folder / "hangs").exists() and (folder / "hangs").read_text():
                break
        steps.close()
    worker = int((folder / "hangs").read_text())
    while True:
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            break
        assert time.monotonic() - started < 90.0, "the worker outlives its run"
        time.sleep(0.05)
