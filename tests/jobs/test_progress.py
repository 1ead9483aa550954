"""Generators of progress: results, errors and cancellation pass between a task and its caller."""

import threading
import time

import pytest

from farfield.addon.core.errors import Cancelled, GeometryError
from farfield.addon.core.jobs.progress import BackgroundThread, Progress, StageClock, run_to_end, subprogress, time_left


def count(steps, closed=None):
    """A task of `steps` steps that returns their count and records that it was closed."""
    try:
        for step in range(steps):
            yield Progress(step / steps, f"step {step}")
        return steps
    finally:
        if closed is not None:
            closed.append(True)


def test_run_to_end_returns_the_result_and_reports_every_step():
    seen = []
    assert run_to_end(count(5), seen.append) == 5
    assert [step.label for step in seen] == [f"step {index}" for index in range(5)]


def test_an_exception_of_the_callback_closes_the_task():
    closed = []

    def cancel(step):
        raise Cancelled("Cancelled.")

    with pytest.raises(Cancelled):
        run_to_end(count(5, closed), cancel)
    assert closed == [True]


def test_subprogress_maps_fractions_and_returns_the_result():
    def both():
        first = yield from subprogress(count(4), 0.0, 0.5)
        second = yield from subprogress(count(2), 0.5, 1.0)
        return first + second

    fractions = []
    assert run_to_end(both(), lambda step: fractions.append(step.fraction)) == 6
    assert fractions == [0.0, 0.125, 0.25, 0.375, 0.5, 0.75]


def test_closing_subprogress_closes_its_steps():
    closed = []
    steps = subprogress(count(5, closed), 0.0, 1.0)
    next(steps)
    steps.close()
    assert closed == [True]


def test_time_left_is_proportional_and_unknown_at_first():
    assert time_left(10.0, 0.25) == pytest.approx(30.0)
    assert time_left(10.0, 1.0) == 0.0
    assert time_left(0.1, 0.5) is None and time_left(10.0, 0.001) is None
    assert time_left(5.0, 0.09) is None and time_left(10.0, 0.05) == pytest.approx(190.0)


def test_stage_clock_sums_repeated_stages_even_if_they_fail():
    clock = StageClock()
    for _ in range(2):
        with pytest.raises(ValueError), clock.stage("work"):
            time.sleep(0.01)
            raise ValueError
    assert clock.seconds["work"] >= 0.02


def test_background_thread_gives_result_and_progress():
    threads = set()

    def steps():
        threads.add(threading.current_thread())
        yield Progress(0.5, "half")
        return "done"

    thread = BackgroundThread(steps())
    assert thread.result() == "done" and thread.is_done
    assert thread.progress == Progress(0.5, "half")
    assert threading.current_thread() not in threads


def test_cancelled_thread_ends_between_two_steps_and_closes_the_task():
    closed, started = [], threading.Event()

    def steps():
        try:
            for step in range(1_000_000):
                started.set()
                time.sleep(0.001)
                yield Progress(step / 1_000_000, "working")
        finally:
            closed.append(True)

    thread = BackgroundThread(steps())
    started.wait(10)
    thread.cancel()
    assert thread.wait(10)
    assert closed == [True]
    with pytest.raises(Cancelled):
        thread.result()


def test_exceptions_of_the_task_are_raised_by_result():
    def steps():
        yield Progress(0.0, "start")
        raise GeometryError("Broken.")

    with pytest.raises(GeometryError, match="Broken"):
        BackgroundThread(steps()).result()
