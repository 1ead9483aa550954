"""A worker goes on while its run is alive, and no longer."""

import os
import subprocess
import sys
import threading
import time

import pytest

import environment
from farfield.addon.core import lease
from farfield.addon.core.errors import FileError

CHILD = f"""
import os, sys, time
sys.path.insert(0, {str(environment.ROOT / "scripts")!r})
import environment
environment.import_farfield()
from pathlib import Path
from farfield.addon.core import lease
lease.watch(Path(sys.argv[1]), lambda: os._exit(3))
Path(sys.argv[2]).touch()
time.sleep(120)
"""


def ended(path) -> threading.Event:
    """Set once a watch of `path` in this process has ended."""
    event = threading.Event()
    lease.watch(path, event.set)
    return event


def test_a_watch_lasts_as_long_as_its_lease(tmp_path):
    with lease.held(tmp_path) as held:
        event = ended(held.path)
        assert not event.wait(3 * lease.LOOK)
    assert event.wait(30.0)
    assert not list(tmp_path.iterdir())


def test_a_new_run_ends_the_one_before(tmp_path):
    with lease.held(tmp_path) as first:
        event = ended(first.path)
        with lease.held(tmp_path) as second:
            assert event.wait(30.0)
            with pytest.raises(FileError, match="Another run has begun"):
                first.renew()
            second.renew()


def test_a_lease_that_nobody_renews_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(lease, "PATIENCE", 1.0)
    with lease.held(tmp_path) as held:
        event = ended(held.path)
        for _ in range(8):
            held.renew()
            assert not event.wait(0.25)
        assert event.wait(30.0)


def test_a_folder_that_is_none_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="file"), lease.held(tmp_path / "file"):
        pass


@pytest.mark.skipif(os.name == "nt", reason="Windows does not tell a process that its parent died; the lease runs out instead")
def test_a_worker_ends_with_the_process_that_started_it(tmp_path):
    with lease.held(tmp_path) as held:
        ready = tmp_path / "ready"
        parent = "import subprocess, sys, time; print(subprocess.Popen(sys.argv[1:]).pid, flush=True); time.sleep(120)"
        command = [sys.executable, "-c", parent, sys.executable, "-c", CHILD, str(held.path), str(ready)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        child = int(process.stdout.readline())
        started = time.monotonic()
        while not ready.exists():
            assert time.monotonic() - started < 60.0
            time.sleep(0.02)
        process.kill()
        process.wait()
        while _runs(child):
            assert time.monotonic() - started < 90.0, "the worker outlives its parent"
            time.sleep(0.05)


def _runs(number: int) -> bool:
    """Whether there is a process of that number that has not ended."""
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(number)], capture_output=True, text=True, check=False).stdout
    return bool(state) and not state.startswith("Z")
