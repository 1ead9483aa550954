"""Run all tests that this machine can run, the fast ones first, and list the skipped tests with the reasons.

    python3 scripts/test.py [arguments of pytest]

Test files run in parallel, one per core but at most four, since each process loads a Blender; `-n 0` runs them one after the other.

The first run creates an environment, see lib/environment.py. FARFIELD_BPY=4.5, 5.0 or 5.2 selects the Blender to test with.
"""

import os
import platform
import sys

from lib import environment

environment.ensure(extra_modules=("pytest", "pytest_timeout", "xdist", "hypothesis"))


# A crash of Blender ends the run: xdist may wait forever for the replacement of a worker.
PARALLEL_OPTIONS = ("-n", "auto", "--maxprocesses", "4", "--dist", "loadfile", "--no-loadscope-reorder", "--max-worker-restart", "0")


class CrashRecorder:
    """Records the tests in which a worker crashed."""

    def __init__(self) -> None:
        self.tests: list[str] = []

    def pytest_handlecrashitem(self, crashitem: str) -> None:
        """Record one test."""
        self.tests.append(crashitem)


def main() -> int:
    from importlib.metadata import version

    import pytest

    os.chdir(environment.ROOT)
    print(f"Farfield's tests with bpy {version('bpy')}, Python {platform.python_version()}, NumPy {version('numpy')}", flush=True)
    arguments, crashes = [*PARALLEL_OPTIONS, *sys.argv[1:]], CrashRecorder()
    code = pytest.main(arguments, plugins=[crashes])
    if not crashes.tests:
        return code
    # Blender has crashed once for an unknown reason; a second run distinguishes this from a defect of Farfield.
    print(f"\nWARNING: BLENDER CRASHED in {', '.join(crashes.tests)}. All tests are run again.", flush=True)
    return pytest.main(arguments)


if __name__ == "__main__":
    sys.exit(main())
