"""A worker runs while its run is alive, and no longer."""

import os
import subprocess
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest

from farfield.addon.core.errors import FileError
from farfield.addon.core.jobs import heartbeat
from lib import environment

pytestmark = pytest.mark.core
CHILD = f"""
import os, sys, time
sys.path.insert(0, {str(environment.ROOT / "scripts")!r})
from lib import environment
environment.import_farfield()
from pathlib import Path
from farfield.addon.core.jobs import heartbeat
heartbeat.watch(Path(sys.argv[1]), lambda: os._exit(3))
Path(sys.argv[2]).touch()
time.sleep(120)
"""


def watch_event(path) -> threading.Event:
    """Return an event that is set once a watch of `path` in this process has ended."""
    event = threading.Event()
    heartbeat.watch(path, event.set)
    return event


def test_a_watch_ends_with_its_run(tmp_path, monkeypatch):
    monkeypatch.setattr(heartbeat, "POLL_SECONDS", 0.05)
    with closing(heartbeat.take_over(tmp_path)) as beat:
        event = watch_event(beat.path)
        assert not event.wait(3 * heartbeat.POLL_SECONDS)
    assert event.wait(30.0)
    assert not list(tmp_path.iterdir())


def test_a_new_run_ends_the_previous_one(tmp_path):
    with closing(heartbeat.take_over(tmp_path)) as first:
        event = watch_event(first.path)
        with closing(heartbeat.take_over(tmp_path)) as second:
            assert event.wait(30.0)
            with pytest.raises(FileError, match="Another run has started"):
                first.renew()
            second.renew()


def test_a_run_without_heartbeat_times_out(tmp_path, monkeypatch):
    """A clock that runs while the watch sleeps replaces that of the system."""
    now = 1000.0

    def sleep(seconds):
        nonlocal now
        now += seconds
        if now < 1000.0 + 5.0 * heartbeat.TIMEOUT_SECONDS:
            assert not event.is_set()
            os.utime(beat.path, (now, now))

    monkeypatch.setattr(heartbeat, "time", SimpleNamespace(monotonic=lambda: now, sleep=sleep))
    event = threading.Event()
    with closing(heartbeat.take_over(tmp_path)) as beat:
        heartbeat.watch(beat.path, event.set)
        assert event.wait(30.0)
    assert now == pytest.approx(1000.0 + 6.0 * heartbeat.TIMEOUT_SECONDS, abs=3.0 * heartbeat.POLL_SECONDS)


def test_an_invalid_folder_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="file"), closing(heartbeat.take_over(tmp_path / "file")):
        pass


@pytest.mark.skipif(os.name == "nt", reason="On Windows a process does not notice the death of its parent; the heartbeat times out instead")
def test_a_worker_ends_with_its_parent_process(tmp_path):
    with closing(heartbeat.take_over(tmp_path)) as beat:
        ready = tmp_path / "ready"
        parent = "import subprocess, sys, time; print(subprocess.Popen(sys.argv[1:]).pid, flush=True); time.sleep(120)"
        command = [sys.executable, "-c", parent, sys.executable, "-c", CHILD, str(beat.path), str(ready)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        child = int(process.stdout.readline())
        started = time.monotonic()
        while not ready.exists():
            assert time.monotonic() - started < 60.0
            time.sleep(0.02)
        process.kill()
        process.wait()
        while _is_running(child):
            assert time.monotonic() - started < 90.0, "the worker outlives its parent"
            time.sleep(0.05)


def _is_running(pid: int) -> bool:
    """Return whether the process exists and has not ended."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False).stdout
    return bool(state) and not state.startswith("Z")


@pytest.mark.parametrize("attempt", range(4))
def test_of_two_runs_that_start_at_the_same_time_one_continues(tmp_path, monkeypatch, attempt):
    """Both look for earlier runs before one of them has created its file."""
    barrier, touch, outcomes = threading.Barrier(2), Path.touch, []

    def touch_together(path: Path) -> None:
        barrier.wait(30.0)
        touch(path)
        barrier.wait(30.0)

    def run() -> None:
        try:
            outcomes.append(heartbeat.take_over(tmp_path))
        except FileError as error:
            outcomes.append(error)

    monkeypatch.setattr(Path, "touch", touch_together)
    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    (held,) = (outcome for outcome in outcomes if isinstance(outcome, heartbeat.Heartbeat))
    (error,) = (outcome for outcome in outcomes if isinstance(outcome, FileError))
    assert "Another run has started" in str(error)
    assert [held.path] == list(tmp_path.iterdir())
    held.renew()


def test_a_run_is_alive_while_its_process_runs_whatever_the_clock_says(tmp_path):
    assert not heartbeat.is_alive(tmp_path)
    with closing(heartbeat.take_over(tmp_path)) as held:
        for seconds in (-1e6, 0.0, 1e6):  # The clock was set forward or back after the last touch.
            os.utime(held.path, (time.time() + seconds,) * 2)
            assert heartbeat.is_alive(tmp_path)
    machine = held.path.name.split("-")[1]
    (tmp_path / f"farfield-{machine}-{2**22 + 1}-1-0.heartbeat").touch()  # No process has this number.
    assert not heartbeat.is_alive(tmp_path)


def test_a_run_on_another_machine_is_alive_while_it_touches_its_file(tmp_path):
    path = tmp_path / "farfield-00000000-1-1-0.heartbeat"
    path.touch()
    assert heartbeat.is_alive(tmp_path)
    os.utime(path, (time.time() - 2.0 * heartbeat.TIMEOUT_SECONDS,) * 2)
    assert not heartbeat.is_alive(tmp_path)
