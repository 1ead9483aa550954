"""Tasks side by side give the results of tasks one after the other, and end together."""

import threading

import pytest

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.jobs.parallel_steps import run_in_parallel
from farfield.addon.core.jobs.progress import Progress, Steps, run_to_end


def count_to(number: int, ended: list[int]) -> Steps[int]:
    try:
        for step in range(number):
            yield Progress(step / number, f"task {number}")
    finally:
        ended.append(number)
    return number


@pytest.mark.parametrize("count", [0, 1, 2, 9])
def test_results_are_in_order_and_progress_grows_to_the_end(count):
    fractions, ended = [], []
    tasks = [count_to(number, ended) for number in range(20, 20 + count)]
    assert run_to_end(run_in_parallel(tasks), lambda progress: fractions.append(progress.fraction)) == list(range(20, 20 + count))
    assert fractions == sorted(fractions) and all(0.0 <= fraction <= 1.0 for fraction in fractions)
    assert sorted(ended) == list(range(20, 20 + count))


def fail() -> Steps[int]:
    yield Progress(0.0, "task that fails")
    raise GeometryError("This is wrong.")


def wait_for(event: threading.Event, ended: list[int]) -> Steps[int]:
    try:
        while not event.is_set():
            yield Progress(0.5, "waiting")
    finally:
        ended.append(1)
    return 1


def test_an_exception_ends_all_tasks():
    ended: list[int] = []
    with pytest.raises(GeometryError, match="wrong"):
        run_to_end(run_in_parallel([wait_for(threading.Event(), ended), fail(), count_to(5, ended)]))
    assert 1 in ended


def test_closing_ends_all_tasks():
    ended: list[int] = []
    steps = run_in_parallel([wait_for(threading.Event(), ended), wait_for(threading.Event(), ended)])
    assert next(steps).label == "waiting"
    steps.close()
    assert ended == [1, 1]
