"""Run the tests that this machine can run, and list the skipped tests with the reasons.

    python3 scripts/test.py [--slow] [--all] [--window] [--record] [arguments of pytest]

`--slow` adds the tests that take seconds, `--all` also the exhaustive variants and more random examples. Tests that open a Blender window
(tests/gui) run only with `--window`, or if they are named: `python3 scripts/test.py tests/gui`. `--record` writes how long the tests took,
see lib/durations.py.

Test files run in parallel, the longest ones first, see lib/schedule.py; `-n 0` runs them one after the other. If
Blender crashes in one of the processes, the test files that have no result are run once more, in a new process.

The first run creates an environment, see lib/environment.py. FARFIELD_BPY=4.5, 5.0 or 5.2 selects the Blender to test with.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lib import environment

environment.ensure(extra_modules=("pytest", "pytest_timeout", "xdist", "hypothesis"))

from lib import crash_recorder, window_tests  # which need pytest

# A crash of Blender ends the run: xdist may wait forever for the replacement of a worker.
PARALLEL_OPTIONS = ("-n", "auto", "--dist", "loadfile", "--max-worker-restart", "0")


MEMORY_DISK = Path("/dev/shm")  # a file system in memory, on Linux
MEMORY_DISK_BYTES = 8 * 10**9  # This much of it must be free: the tests write 2 GB altogether.


def use_memory_disk() -> None:
    """Let the tests write their temporary files to memory where that is possible, unless TMPDIR names another folder: they write thousands,
    and wait until the disk has stored many of them."""
    with suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        available = 1024 * int(next(line.split()[1] for line in lines if line.startswith("MemAvailable:")))
        if "TMPDIR" not in os.environ and min(available, shutil.disk_usage(MEMORY_DISK).free) >= MEMORY_DISK_BYTES:
            os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY_DISK)


@contextmanager
def use_bytecode_folder() -> Iterator[None]:
    """Where Python may write no compiled modules next to the modules, keep them in the folder of the environments. Otherwise each of the
    processes, some hundreds, compiles everything again. Nothing is kept of modules in temporary folders."""
    if not sys.dont_write_bytecode:
        yield
        return
    folder = Path(sys.pycache_prefix or environment.environments_folder() / "bytecode")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = str(folder)
    sys.dont_write_bytecode, sys.pycache_prefix = False, str(folder)
    try:
        yield
    finally:
        for place in {Path(tempfile.gettempdir()).resolve(), MEMORY_DISK}:
            for path in (folder / place.relative_to(place.anchor)).glob("farfield-tests-*"):
                shutil.rmtree(path, ignore_errors=True)


def main() -> int:
    from importlib.metadata import version

    import pytest

    os.chdir(environment.ROOT)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes share the cores; waiting threads of BLAS would keep them busy
    recorder, window = crash_recorder.CrashRecorder(), window_tests.WindowTests(sys.argv[1:])
    if not window.are_included:  # the program with the window does not see this folder
        use_memory_disk()
    variables = dict(os.environ)  # conftest.py changes them
    print(f"Farfield's tests with bpy {version('bpy')}, Python {platform.python_version()}, NumPy {version('numpy')}", flush=True)
    options = ["-p", "lib.rerun_selection", "-p", "lib.schedule", *PARALLEL_OPTIONS]
    code = pytest.main([*options, *window.arguments], plugins=[recorder, window])
    if not recorder.crashed or crash_recorder.SELECTION_VARIABLE in variables:
        return code
    tests = recorder.tests_to_repeat()
    print(f"\nWARNING: BLENDER CRASHED in {', '.join(recorder.crashed)}. {len(tests)} tests without a result are run again.", flush=True)
    with tempfile.TemporaryDirectory(prefix="farfield-tests-", dir=variables.get("TMPDIR")) as folder:
        selection = Path(folder) / "tests.json"
        selection.write_text(json.dumps(tests), encoding="utf-8")
        variables[crash_recorder.SELECTION_VARIABLE] = str(selection)
        code = subprocess.run([sys.executable, __file__, *sys.argv[1:]], env=variables, check=False).returncode
    if recorder.other_failures:
        print(f"Before the crash these tests failed: {', '.join(sorted(recorder.other_failures))}", flush=True)
        return code or 1
    return code


if __name__ == "__main__":
    with use_bytecode_folder():
        exit_code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(exit_code)  # Blender 4.5 as a Python module may hang at exit.
