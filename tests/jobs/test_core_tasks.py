"""Task pools give the same replies serially and in processes, which survive one crash, end with their run and never import Blender."""

import os
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.errors import FarfieldError, FileError, SettingsError
from farfield.addon.core.jobs import core_worker, heartbeat
from farfield.addon.core.jobs.executors import parse_executor
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.jobs.task_pool import TaskPool
from farfield.addon.core.jobs.task_processes import MAX_BATCH_ITEMS, split_into_batches

MODULE = "tests.jobs.sample_tasks"
SPECS = ["serial", "processes:2"]


@contextmanager
def open_pool(folder: Path, word: str, task: str) -> Iterator[TaskPool]:
    """Open a pool for a task of `sample_tasks` that may write in `folder`."""
    with (
        closing(heartbeat.take_over(folder)) as held,
        parse_executor(word).open_task_pool(MODULE, [task, str(folder)], held, "tiles") as pool,
    ):
        yield pool


def run(folder: Path, word: str, task: str, items: list) -> list:
    with open_pool(folder, word, task) as pool:
        return run_to_end(pool.run(items, "Tiles"))


def read_processes(path: Path) -> list[int]:
    """Return the processes that have noted themselves in a file, in order."""
    return [int(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def start_hanging(folder: Path, pool: TaskPool):
    """Return the generator of a run whose two processes hang."""
    steps = pool.run(list(range(10)), "Tiles")
    started = time.monotonic()
    for _ in steps:
        assert time.monotonic() - started < 60.0
        if len(read_processes(folder / "hangs")) == 2:
            break
    return steps


def assert_ended(processes: list[int]) -> None:
    """This process, their parent, has waited for them."""
    if os.name == "nt":  # has no such question
        return
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_serial_and_processes_give_the_same_replies_in_the_order_of_the_items(tmp_path):
    items = [{"number": number, "text": "Höhe \udcff\n" * (number % 3)} for number in range(150)]
    serial, spread = (run(tmp_path, spec, "describe", items) for spec in SPECS)
    assert serial == spread
    assert [reply["double"] for reply in serial] == list(range(0, 300, 2))
    assert serial[7] == {"double": 14, "text": items[7]["text"], "tuple": [1, None, 0.1], "7": []}


def test_processes_live_over_several_runs(tmp_path):
    with open_pool(tmp_path, "processes:2", "write") as pool:
        for level in range(4):
            items = list(range(100 * level, 100 * level + 20))
            fractions = []
            assert run_to_end(pool.run(items, f"Level {level}"), lambda step: fractions.append(step.fraction)) == [None] * 20  # noqa: B023
            assert [(tmp_path / f"{item}.txt").read_text(encoding="utf-8") for item in items] == [str(item * item) for item in items]
            assert fractions == sorted(fractions) and fractions[0] >= 0.0 and fractions[-1] <= 1.0
        assert run_to_end(pool.run([], "Nothing")) == []
    processes = set(read_processes(tmp_path / "processes"))
    assert 1 <= len(processes) <= 2 and os.getpid() not in processes
    assert_ended(list(processes))


def test_serial_tasks_run_in_this_process(tmp_path):
    run(tmp_path, "serial", "write", [1, 2])
    assert set(read_processes(tmp_path / "processes")) == {os.getpid()}


def test_a_worker_has_scipy_and_one_thread_but_neither_blender_nor_the_extension(tmp_path):
    (state,) = run(tmp_path, "processes:1", "process_state", [0])
    assert not state["blender"] and not state["root"]
    assert state["threads"] in (None, "2")  # the second one watches the heartbeat


@pytest.mark.parametrize("spec", SPECS)
def test_an_error_of_a_task_is_the_same_sentence_everywhere(tmp_path, spec):
    with pytest.raises(FarfieldError) as raised:
        run(tmp_path, spec, "fail", list(range(8)))
    assert str(raised.value) == "Kein Platz für „Kachel 3“."


@pytest.mark.parametrize("spec", SPECS)
def test_an_error_of_the_module_is_the_same_sentence_everywhere(tmp_path, spec):
    with pytest.raises(FarfieldError, match=r"^The tasks cannot be opened\.$"):
        run(tmp_path, spec, "refuse", [1])


@pytest.mark.parametrize(
    ("task", "error", "message"),
    [
        ("raise_exception", RuntimeError, "in a worker process, ZeroDivisionError: Null ist null"),
        ("exhaust", FarfieldError, "out of memory"),
    ],
)
def test_another_exception_in_a_worker_is_passed_on(tmp_path, task, error, message):
    with pytest.raises(error, match=message) as raised:
        run(tmp_path, "processes:2", task, list(range(8)))
    assert error is FarfieldError or "Traceback" in "".join(raised.value.__notes__)


def test_items_at_which_a_worker_crashes_once_are_retried(tmp_path):
    assert run(tmp_path, "processes:2", "crash_once", list(range(40))) == [-item for item in range(40)]
    calls = read_processes(tmp_path / "calls")
    assert len(calls) == 42 and 3 <= len(set(calls)) <= 4


def test_a_second_crash_at_the_same_item_ends_the_run(tmp_path):
    with open_pool(tmp_path, "processes:2", "crash") as pool:
        with pytest.raises(FarfieldError, match=r"crashed twice at the same tiles \(.*Finished tiles are kept; resume with fewer"):
            run_to_end(pool.run(list(range(40)), "Tiles"))
        assert_ended(read_processes(tmp_path / "calls"))
        assert run_to_end(pool.run([1, 2], "Tiles")) == [1, 2], "the next run starts new processes"


def test_processes_that_end_between_two_runs_are_replaced(tmp_path):
    with open_pool(tmp_path, "processes:2", "fail") as pool:
        for _ in range(2):
            assert run_to_end(pool.run([0, 1, 2, 4], "Tiles")) == [0, 1, 2, 4]
            for worker in pool._workers:
                worker.process.kill()
                worker.process.wait()


def test_closing_the_generator_leaves_no_process(tmp_path):
    with open_pool(tmp_path, "processes:2", "hang") as pool:
        steps = start_hanging(tmp_path, pool)
        steps.close()
        assert_ended(read_processes(tmp_path / "hangs"))


def test_the_end_of_the_block_leaves_no_process(tmp_path):
    with open_pool(tmp_path, "processes:2", "hang") as pool:
        steps = start_hanging(tmp_path, pool)
    assert_ended(read_processes(tmp_path / "hangs"))
    steps.close()
    assert [path.name for path in tmp_path.iterdir()] == ["hangs"]


def test_a_later_run_in_the_same_folder_ends_the_first_one(tmp_path):
    with open_pool(tmp_path, "processes:2", "hang") as pool:
        steps = start_hanging(tmp_path, pool)
        heartbeat.take_over(tmp_path)
        with pytest.raises(FileError, match="Another run has started"):
            run_to_end(steps)
        assert_ended(read_processes(tmp_path / "hangs"))


def test_a_worker_ends_when_the_heartbeat_ends(tmp_path):
    """Also when nobody reads its pipes."""
    with open_pool(tmp_path, "processes:2", "hang") as pool:
        steps = start_hanging(tmp_path, pool)
        for path in tmp_path.glob(f"*{heartbeat.FILE_SUFFIX}"):
            path.unlink()
        started = time.monotonic()
        workers = [worker.process for worker in pool._workers]
        while any(worker.poll() is None for worker in workers):
            assert time.monotonic() - started < 30.0, "a worker outlives its run"
            time.sleep(0.05)
        assert {worker.returncode for worker in workers} == {heartbeat.EXIT_RUN_GONE}
        with pytest.raises(FileError, match="Another run has started"):
            run_to_end(steps)


def test_a_serial_run_can_be_cancelled_between_items(tmp_path):
    with open_pool(tmp_path, "serial", "write") as pool:
        steps = pool.run([1, 2, 3], "Tiles")
        next(steps)
        steps.close()
    assert not (tmp_path / "processes").exists()


def test_serial_pools_in_several_threads_do_not_disturb_each_other(tmp_path):
    outcomes = {}

    def work(index):
        folder = tmp_path / str(index)
        folder.mkdir()
        outcomes[index] = run(folder, "serial", "fail", [10 * index, index + 10])

    threads = [threading.Thread(target=work, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert outcomes == {index: [10 * index, index + 10] for index in range(4)}


def test_an_invalid_executor_is_a_settings_error(tmp_path):
    with pytest.raises(SettingsError, match="must be serial"):
        run(tmp_path, "threads:2", "write", [1])


def test_a_blender_without_a_python_program_is_one_sentence(tmp_path, monkeypatch):
    for program in ("", None, "/opt/blender/blender"):
        monkeypatch.setattr(core_worker.sys, "executable", program)
        with pytest.raises(FarfieldError, match="set Executor to serial"):
            run(tmp_path, "processes:2", "write", [1])
        assert run(tmp_path, "serial", "fail", [1]) == [1]


@given(st.integers(0, 1000), st.integers(1, 40))
def test_batches_cover_all_items_in_order_and_become_shorter(count, slots):
    batches = split_into_batches(count, slots)
    assert [index for batch in batches for index in batch] == list(range(count))
    lengths = [len(batch) for batch in batches]
    assert lengths == sorted(lengths, reverse=True) and (not count or lengths[-1] == 1)
    assert max(lengths, default=1) <= MAX_BATCH_ITEMS
    assert np.sum(np.array(lengths) == 1) >= min(count, slots)
