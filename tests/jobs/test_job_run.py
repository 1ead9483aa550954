"""Background jobs: core in a thread, scene on the main thread; cancelled and failed jobs restore their changes."""

import threading
import time

import pytest

from farfield.addon.core.errors import Cancelled, GeometryError
from farfield.addon.core.jobs.progress import Progress, run_to_end
from farfield.addon.operators import job_run, long_work
from farfield.addon.panels import sidebar

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


@pytest.mark.parametrize("is_in_scene", [False, True])
@pytest.mark.parametrize(
    ("given", "message"), [({}, "Cancelled; nothing was changed."), ({"cancel_message": "Half is done."}, "Half is done.")]
)
def test_a_cancelled_run_says_what_was_changed(given, message, is_in_scene):
    run = job_run.Run(Job(steps=4 if is_in_scene else 100_000), "Count", **given)
    advance_until(run, lambda: run.uses_scene if is_in_scene else run.progress.fraction > 0.0)
    run.cancel()
    with pytest.raises(Cancelled, match=message):
        advance_until(run, lambda: False)
    run.close()


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


class Layout:
    """Records what a panel draws: kinds of items with what they show, and whether they can be used."""

    def __init__(self):
        self.enabled, self.items, self.children = True, [], []

    def row(self, align=False):
        self.children.append(Layout())
        return self.children[-1]

    column = row

    def progress(self, factor, type, text):
        self.items.append(("progress", text))

    def label(self, text, icon="NONE"):
        self.items.append(("label", text))

    def operator(self, name, text, icon):
        self.items.append(("operator", name))

    def usable(self, kind):
        """Return what can be used of one kind."""
        shown = [text for item, text in self.items if item == kind] if self.enabled else []
        return shown + [text for child in self.children for text in child.usable(kind)]


def test_the_progress_bar_has_a_cancel_button(monkeypatch):
    def draw():
        layout = Layout()
        assert sidebar.draw_progress_bar(layout)
        return layout

    job = Job(steps=400)
    run = job_run.Run(job, "Test")
    monkeypatch.setattr(long_work, "_current", run)
    try:
        assert draw().usable("operator") == ["farfield.cancel_job"] and draw().usable("progress") == [f"{run.progress.fraction:.0%}"]
        run.cancel()
        assert draw().usable("operator") == [] and "Cancelling" in draw().usable("label")
    finally:
        run.close()
    monkeypatch.setattr(long_work, "_current", None)
    assert not sidebar.draw_progress_bar(Layout())


def test_the_cancel_button_is_disabled_while_the_scene_is_used(monkeypatch):
    """A modal operator receives all events then, and cancels on Esc."""
    run = job_run.Run(Job(), "Test")
    monkeypatch.setattr(long_work, "_current", run)
    while not run.uses_scene:
        run.advance()
    layout = Layout()
    assert sidebar.draw_progress_bar(layout) and layout.usable("operator") == []
    run.close()
