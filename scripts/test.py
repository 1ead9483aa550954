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


# Where Blender crashes, the run ends and names the test: xdist may wait for ever for a worker that takes its place.
SIDE_BY_SIDE = ("-n", "auto", "--maxprocesses", "4", "--dist", "loadfile", "--no-loadscope-reorder", "--max-worker-restart", "0")


def main() -> int:
    from importlib.metadata import version

    import pytest

    os.chdir(environment.ROOT)
    print(f"Farfield's tests with bpy {version('bpy')}, Python {platform.python_version()}, NumPy {version('numpy')}", flush=True)
    return pytest.main([*SIDE_BY_SIDE, *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
