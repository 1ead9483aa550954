"""Run every test that this machine can run, the fast ones first, and say what was left out and why.

    python3 scripts/test.py [arguments of pytest]

Files run side by side, as many as there are cores, four at most, since each holds a Blender; `-n 0` runs one after the other.

The first run makes an environment, see environment.py. FARFIELD_BPY=4.5, 5.0 or 5.2 chooses the Blender to test with.
"""

import os
import platform
import sys

import environment

environment.ensure(also=("pytest", "pytest_timeout", "xdist", "hypothesis"))


# Where Blender crashes, the run ends there: xdist may wait for ever for a worker that takes its place.
SIDE_BY_SIDE = ("-n", "auto", "--maxprocesses", "4", "--dist", "loadfile", "--no-loadscope-reorder", "--max-worker-restart", "0")


class Crashes:
    """The tests in which a worker died."""

    def __init__(self) -> None:
        self.tests: list[str] = []

    def pytest_handlecrashitem(self, crashitem: str) -> None:
        """Note one."""
        self.tests.append(crashitem)


def main() -> int:
    from importlib.metadata import version

    import pytest

    os.chdir(environment.ROOT)
    print(f"Farfield's tests with bpy {version('bpy')}, Python {platform.python_version()}, NumPy {version('numpy')}", flush=True)
    arguments, crashes = [*SIDE_BY_SIDE, *sys.argv[1:]], Crashes()
    code = pytest.main(arguments, plugins=[crashes])
    if not crashes.tests:
        return code
    # Blender was seen to die once for no reason that could be found: a second run tells that from a fault of ours.
    print(f"\nWARNING: BLENDER CRASHED in {', '.join(crashes.tests)}. All tests are run once more.", flush=True)
    return pytest.main(arguments)


if __name__ == "__main__":
    sys.exit(main())
