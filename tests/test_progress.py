"""Long work: nothing is lost between a generator and whoever runs it, and it always ends cleanly."""

import threading
import time

import pytest

from farfield.addon.core.errors import GeometryError, Stopped
from farfield.addon.core.progress import Progress, StageClock, finish, scaled, time_left
from farfield.addon.core.worker import Worker


def count(steps, closed=None):
    """A task of `steps` steps that returns their number and notes when it is closed."""
    try:
        for step in range(steps):
            yield Progress(step / steps, f"step {step}")
        return steps
    finally:
        if closed is not None:
            closed.append(True)


def test_finish_returns_the_result_and_shows_every_step():
    seen = []
    assert finish(count(5), seen.append) == 5
    assert [step.label for step in seen] == [f"step {index}" for index in range(5)]


def test_an_exception_from_the_watcher_closes_the_work():
    closed = []

    def stop(step):
        raise Stopped("Stopped.")

    with pytest.raises(Stopped):
        finish(count(5, closed), stop)
    assert closed == [True]


def test_scaled_parts_fill_their_span_and_hand_on_the_result():
    def both():
        first = yield from scaled(count(4), 0.0, 0.5)
        second = yield from scaled(count(2), 0.5, 1.0)
        return first + second

    fractions = []
    assert finish(both(), lambda step: fractions.append(step.fraction)) == 6
    assert fractions == [0.0, 0.125, 0.25, 0.375, 0.5, 0.75]


def test_closing_a_scaled_part_closes_what_it_runs():
    closed = []
    steps = scaled(count(5, closed), 0.0, 1.0)
    next(steps)
    steps.close()
    assert closed == [True]


def test_time_left_is_in_proportion_and_silent_while_too_early():
    assert time_left(10.0, 0.25) == pytest.approx(30.0)
    assert time_left(10.0, 1.0) == 0.0
    assert time_left(0.1, 0.5) is None and time_left(10.0, 0.001) is None


def test_stage_clock_sums_repeated_stages_even_when_they_fail():
    clock = StageClock()
    for _ in range(2):
        with pytest.raises(ValueError), clock.stage("work"):
            time.sleep(0.01)
            raise ValueError
    assert clock.seconds["work"] >= 0.02


def test_worker_runs_elsewhere_and_gives_result_and_progress():
    threads = set()

    def steps():
        threads.add(threading.current_thread())
        yield Progress(0.5, "half")
        return "done"

    worker = Worker(steps())
    assert worker.result() == "done" and worker.done
    assert worker.progress == Progress(0.5, "half")
    assert threading.current_thread() not in threads


def test_stopped_worker_ends_between_two_steps_and_closes_the_work():
    closed, reached = [], threading.Event()

    def steps():
        try:
            for step in range(1_000_000):
                reached.set()
                time.sleep(0.001)
                yield Progress(step / 1_000_000, "working")
        finally:
            closed.append(True)

    worker = Worker(steps())
    reached.wait(10)
    worker.stop()
    assert worker.wait(10)
    assert closed == [True]
    with pytest.raises(Stopped):
        worker.result()


def test_what_the_work_raises_reaches_the_watcher():
    def steps():
        yield Progress(0.0, "start")
        raise GeometryError("Broken.")

    with pytest.raises(GeometryError, match="Broken"):
        Worker(steps()).result()
