"""The order in which parallel processes run the test files."""

from types import SimpleNamespace

import numpy as np
import pytest

from lib.durations import Durations, Measurement, folder_of, to_page, to_table
from lib.schedule import LongestFirst


class Process:
    """Stands in for a process of xdist: its time goes on with each test that it runs."""

    def __init__(self) -> None:
        self.queue, self.done, self.time, self.shutting_down = [], [], 0.0, False
        self.gateway = SimpleNamespace(id=str(id(self)))

    def send_runtest_some(self, indices: list[int]) -> None:
        self.queue += indices

    def shutdown(self) -> None:
        self.shutting_down = True


def ignore(*messages: object) -> None:
    """Stands in for the log of xdist."""


def simulate(seconds: dict[str, float], count: int, expected: dict[str, float] | None = None) -> list[Process]:
    """Run tests that take so many seconds, and are expected to do so, in several processes."""
    durations = Durations()
    durations._expected, durations._expected_of_files = seconds if expected is None else expected, {}
    config = SimpleNamespace(getvalue=lambda _: count * ["popen"], option=SimpleNamespace(loadscopereorder=True))
    log = SimpleNamespace(loadscopesched=ignore, loadfilesched=ignore)
    schedule, processes, tests = LongestFirst(config, log, durations), [Process() for _ in range(count)], list(seconds)
    for process in processes:
        schedule.add_node(process)
    for process in processes:
        schedule.add_node_collection(process, tests)
    schedule.schedule()
    while any(process.queue for process in processes):
        process = min((process for process in processes if process.queue), key=lambda process: process.time)
        index = process.queue.pop(0)
        process.time += seconds[tests[index]]
        process.done.append(tests[index])
        schedule.mark_test_complete(process, index)
    assert schedule.tests_finished and all(process.shutting_down for process in processes)
    return processes


def folders(process: Process) -> list[str]:
    """The folders in which a process worked, in this order, each as often as it came back."""
    names = [folder_of(test) for test in process.done]
    return [name for index, name in enumerate(names) if index == 0 or names[index - 1] != name]


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_every_test_runs_once_and_all_processes_are_busy_to_the_end(count):
    idle = []
    for seed in range(8):
        random = np.random.default_rng(seed)
        files = {f"tests/{random.integers(9)}/test_{index}.py": random.pareto(1.2) + 0.1 for index in range(150)}
        seconds = {f"{file}::test_{index}": min(total, 12.0) / 3 for file, total in files.items() for index in range(3)}
        processes = simulate(seconds, count)
        assert sorted(test for process in processes for test in process.done) == sorted(seconds)
        ends = sorted(process.time for process in processes)
        idle.append((ends[-1] - ends[0]) / ends[-1])
    assert np.mean(idle) < 0.03


def test_a_process_stays_in_its_folder_and_begins_with_the_longest_file():
    seconds = {f"tests/{folder}/test_{index}.py::test": 1.0 + index for folder in "abcd" for index in range(6)}
    processes = simulate(seconds, 2)
    for process in processes:
        assert len(folders(process)) == 2
        assert [test.partition("test_")[2][0] for test in process.done] == list("543210543210")


def test_files_are_not_split():
    seconds = {f"tests/a/test_{file}.py::test_{index}": 1.0 for file in range(5) for index in range(7)}
    for process in simulate(seconds, 2):
        files = [test.partition("::")[0] for test in process.done]
        assert len(files) % 7 == 0 and files == [file for first in range(0, len(files), 7) for file in 7 * [files[first]]]


def test_new_tests_run_too():
    seconds = {f"tests/a/test_{index}.py::test": 1.0 for index in range(9)}
    assert sum(len(process.done) for process in simulate(seconds, 4, expected={})) == 9


def test_seconds_are_those_of_the_last_run_of_the_table_or_a_guess():
    durations = Durations()
    durations._expected, durations._expected_of_files = {"a.py::old": 2.0}, {"a.py": 9.0, "b.py": 7.0}
    assert durations.expect(["a.py::old", "a.py::new"]) == pytest.approx(2.05)
    assert durations.expect(["b.py::new"]) == 7.0
    assert durations.expect(["c.py::1", "c.py::2"]) == pytest.approx(0.1)


def test_the_table_has_the_slowest_files_and_the_page_the_slowest_tests():
    tests = {f"tests/a/test_{index}.py::test_{part}": index / 10 for index in range(30) for part in range(2)}
    table, page = to_table(tests), to_page(Measurement(tests, 100.0, 190.0, 1.5, 2, 3))
    assert table.startswith('{\n "tests/a/test_29.py": 5.8,') and '"tests/a/test_4.py"' not in table
    assert "| 2.9 | `tests/a/test_29.py::test_0` |" in page and "test_19.py" not in page
    assert "| tests, skipped | 60, 3 |" in page and "| `tests/a` | 60 | 87 |" in page
