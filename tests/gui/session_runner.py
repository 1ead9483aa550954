"""Runs sessions in a Blender window with this checkout installed."""

import json
import shutil
import signal
import subprocess
import tempfile
import warnings
from pathlib import Path

from gui.blender_program import find_launcher
from lib import blender_window

WINDOW_SIZE = 1400, 1000
NARROW_WINDOW = 1000, 1000  # Software OpenGL takes two thirds of the time. The sidebar needs the height.
TIMEOUT_SECONDS = 900
_installed: list[Path] = []  # The folders of the extension of earlier sessions.
CRASH_CODES = (-signal.SIGSEGV, 128 + signal.SIGSEGV, -signal.SIGABRT, 128 + signal.SIGABRT)


def run_gui_session(name: str, tmp_path_factory, size: tuple[int, int] = WINDOW_SIZE) -> dict:
    """Run the session in the file `name`, in a window of `size` pixels, and return its results; see session.py.

    After a crash of Blender the session is run once more and the crash log is printed as a warning: one session in dozens has crashed in
    software OpenGL, for an unknown reason. A second crash fails.
    """
    results, log = _run(name, tmp_path_factory, size)
    if not results.exists() and log.returncode in CRASH_CODES:
        warnings.warn(f"Blender crashed during {name} and was started once more.\n{_last_output(log)}", stacklevel=2)
        results, log = _run(name, tmp_path_factory, size)
    assert results.exists(), f"Blender ended with {log.returncode} without results:\n{_last_output(log)}"
    print(f"screenshots and results: {results.parent}")
    print(*(line for line in (log.stdout + log.stderr).splitlines() if "Error" in line or "Traceback" in line), sep="\n")
    return json.loads(results.read_text(encoding="utf-8"))


def assert_progress(fractions: list[float]) -> None:
    """Assert that the progress bar moved, and never back; how often a job was seen on the way depends on the machine."""
    assert fractions == sorted(fractions), fractions
    assert 0.0 <= fractions[0] < fractions[-1] <= 1.0, fractions


def _run(name: str, tmp_path_factory, size: tuple[int, int]) -> tuple[Path, subprocess.CompletedProcess]:
    """Return the path of the results, which exists if the session reached its end, and the finished process."""
    find_launcher()
    resources, output = tmp_path_factory.mktemp("blender"), tmp_path_factory.mktemp("results")
    _install(resources)
    log = blender_window.run(resources, Path(__file__).with_name(name), [output], size=size, seconds=TIMEOUT_SECONDS)
    return output / "results.json", log


def _install(resources: Path) -> None:
    """Install this checkout, or copy the installation of the session before: it contains the modules as Blender has compiled them."""
    folder = resources / "extensions" / "user_default"
    if _installed:
        shutil.copytree(_installed[-1], folder)
    else:
        blender_window.install(resources)
    _installed.append(folder)


def _last_output(log: subprocess.CompletedProcess) -> str:
    """Return the end of Blender's output and of its crash log."""
    crash_log = Path(tempfile.gettempdir()) / "blender.crash.txt"
    crash = crash_log.read_text(encoding="utf-8", errors="replace")[-6000:] if crash_log.exists() else ""
    return f"{log.stdout[-3000:]}\n{log.stderr[-3000:]}\n{crash}"
