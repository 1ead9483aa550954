"""Background jobs: core in a thread, scene on the main thread; cancelled and failed jobs restore their changes."""

import threading
import time

import pytest

from farfield.addon.core.errors import Cancelled, GeometryError
from farfield.addon.core.jobs.progress import Progress, run_to_end
from farfield.addon.operators import job_run

MAIN = threading.main_thread()


class Job:
    """Counts to `steps` twice; records the threads and whether the scene half was closed."""

    core_fraction = 0.35

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
                time.sleep(job_run.TICK)
                yield Progress(step / core_result, "scene")
            if self.failing == "scene":
                raise GeometryError("Broken scene.")
            return f"Made {core_result}."
        finally:
            self.closed = True


def advance_until(run, condition, seconds=20.0):
    """Advance `run` until it finishes or `condition` holds; return the fractions on the way."""
    fractions, started = [], time.monotonic()
    while not condition() and time.monotonic() - started < seconds:
        finished = run.advance()
        fractions.append(run.progress.fraction)
        if finished:
            break
        time.sleep(0.001)
    return fractions


def test_halves_run_in_their_threads_and_progress_never_decreases():
    job = Job()
    run = job_run.Run(job, "Count")
    fractions = advance_until(run, lambda: run.message is not None)
    assert run.message == "Made 4."
    assert job.threads[0] is not MAIN and job.threads[1] is MAIN
    assert fractions == sorted(fractions) and fractions[-1] > Job.core_fraction


def test_blocking_execution_returns_the_same_message():
    assert run_to_end(job_run.run_job(Job())) == "Made 4."


def test_cancelling_in_the_core_skips_the_scene():
    job = Job(steps=100_000)
    run = job_run.Run(job, "Count")
    advance_until(run, lambda: run.progress.fraction > 0.0)
    run.cancel()
    assert run.cancel_requested and "cancelling" in job_run.status_text(run)
    with pytest.raises(Cancelled):
        advance_until(run, lambda: False)
    assert len(job.threads) == 1


def test_cancelling_in_the_scene_closes_its_steps():
    job = Job()
    run = job_run.Run(job, "Count")
    advance_until(run, lambda: run.uses_scene)
    run.cancel()
    with pytest.raises(Cancelled):
        run.advance()
    run.close()
    assert job.closed


@pytest.mark.parametrize("half", ["core", "scene"])
def test_errors_of_both_halves_are_raised(half):
    run = job_run.Run(Job(failing=half), "Count")
    with pytest.raises(GeometryError, match=f"Broken {half}"):
        advance_until(run, lambda: False)


def test_close_ends_a_job_at_any_time():
    job = Job(steps=100_000)
    run = job_run.Run(job, "Count")
    advance_until(run, lambda: run.progress.fraction > 0.0)
    run.close()
    with pytest.raises(Cancelled):
        run.advance()


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "1 s"), (59.0, "59 s"), (61.0, "1 min 1 s"), (7260.0, "2 h 1 min")])
def test_durations_are_formatted_with_two_units(seconds, text):
    assert job_run.format_duration(seconds) == text
