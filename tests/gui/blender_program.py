"""The Blender program that tests start, where this machine has one."""

import subprocess
from pathlib import Path

import pytest

import environment

LAUNCHER = environment.ROOT.parent / "shared" / "tools" / "blender-gui"


def launcher() -> Path:
    """The command that starts Blender; the test is skipped, loudly, where there is none."""
    if not LAUNCHER.exists():
        pytest.skip("BLENDER'S WINDOW WAS NOT TESTED: there is no ../shared/tools/blender-gui to open one with")
    folder = Path(subprocess.run([LAUNCHER, "path"], capture_output=True, text=True, check=True).stdout.strip())
    if not folder.exists():
        pytest.skip("BLENDER'S WINDOW WAS NOT TESTED: run `../shared/tools/blender-gui setup` once")
    return LAUNCHER
