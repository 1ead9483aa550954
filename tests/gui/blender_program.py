"""The Blender program that GUI tests start, if this machine has one."""

from pathlib import Path

import pytest

from lib import blender_window


def find_launcher() -> Path:
    """Return the command that starts Blender; skip the test with a clear message if there is none."""
    reason = blender_window.unavailable_reason()
    if reason:
        pytest.skip(f"BLENDER'S WINDOW WAS NOT TESTED: {reason}")
    return blender_window.LAUNCHER
