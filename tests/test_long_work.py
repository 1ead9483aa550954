"""A job in a window: core in a thread, scene on the main thread, stopped and broken jobs put back what they changed."""

import threading
import time

import pytest

from farfield.addon.core.errors import GeometryError, Stopped
from farfield.addon.core.progress import Progress, finish
from farfield.addon.operators import long_work

MAIN = threading.main_thread()


class Job:
    """Counts to `steps` twice; notes who ran what and whether the scene half was closed."""

    core_share = 0.35

    def __init__(self, steps=4, failing=None):
        self.steps, self.failing, self.threads, self.closed = steps, failing, [], False

    def core_steps(self):
        self.threads.append(threading.current_thread())
        for step in range(self.steps):
            time.sleep(0.002)
            yield Progress(step / self.steps, "core")
        if self.failing == "core":
            raise GeometryError("Broken core.")
        return self.steps

    def scene_steps(self, core_result):
        self.threads.append(threading.current_thread())
        try:
            for step in range(core_result):
                time.sleep(long_work.TICK)
                yield Progress(step / core_result, "scene")
            if self.failing == "scene":
                raise GeometryError("Broken scene.")
            return f"Made {core_result}."
        finally:
            self.closed = True


def advance_until(run, condition, seconds=20.0):
    """Advance `run` until it finishes or `condition` holds; the fractions that were seen."""
    fractions, started = [], time.monotonic()
    while not condition() and time.monotonic() - started < seconds:
        finished = run.advance()
        fractions.append(run.progress.fraction)
        if finished:
            break
        time.sleep(0.001)
    return fractions


def test_both_halves_run_where_they_belong_and_the_bar_only_grows():
    job = Job()
    run = long_work.Run(job, "Count")
    fractions = advance_until(run, lambda: run.sentence is not None)
    assert run.sentence == "Made 4."
    assert job.threads[0] is not MAIN and job.threads[1] is MAIN
    assert fractions == sorted(fractions) and fractions[-1] > Job.core_share


def test_execute_and_window_say_the_same():
    assert finish(long_work.whole(Job())) == "Made 4."


def test_stopping_in_the_core_never_enters_the_scene():
    job = Job(steps=100_000)
    run = long_work.Run(job, "Count")
    advance_until(run, lambda: run.progress.fraction > 0.0)
    run.stop()
    assert run.stopping and "stopping" in long_work.status_text(run)
    with pytest.raises(Stopped):
        advance_until(run, lambda: False)
    assert len(job.threads) == 1


def test_stopping_in_the_scene_lets_it_put_things_back():
    job = Job()
    run = long_work.Run(job, "Count")
    advance_until(run, lambda: run.in_scene)
    run.stop()
    with pytest.raises(Stopped):
        run.advance()
    run.close()
    assert job.closed


@pytest.mark.parametrize("half", ["core", "scene"])
def test_errors_of_either_half_are_raised_to_the_operator(half):
    run = long_work.Run(Job(failing=half), "Count")
    with pytest.raises(GeometryError, match=f"Broken {half}"):
        advance_until(run, lambda: False)


def test_close_ends_a_job_at_any_time():
    job = Job(steps=100_000)
    run = long_work.Run(job, "Count")
    advance_until(run, lambda: run.progress.fraction > 0.0)
    run.close()
    with pytest.raises(Stopped):
        run.advance()


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "1 s"), (59.0, "59 s"), (61.0, "1 min 1 s"), (7260.0, "2 h 1 min")])
def test_durations_read_like_speech(seconds, text):
    assert long_work.duration(seconds) == text
