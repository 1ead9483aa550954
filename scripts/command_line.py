"""What all scripts share: arguments, the progress line, reports, exit codes.

Exit codes: 0 done, 2 bad input with one sentence on stderr, 130 stopped. To be imported after `environment.ensure()`.
"""

import argparse
import json
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import bpy

import environment

farfield = environment.import_farfield()

from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.progress import Progress, time_left
from farfield.addon.operators.long_work import duration
from whole_files import whole_file

DONE, BAD_INPUT, STOPPED = 0, 2, 130
LINE_WIDTH = 78
NEGATIVE = re.compile(r"-\.?\d")


class Parser(argparse.ArgumentParser):
    """Refuses in one sentence, and takes numbers that begin with a minus, and lists of them, for what they are."""

    def parse_args(self, args: list[str], namespace: argparse.Namespace | None = None) -> argparse.Namespace:
        """As `argparse` does it."""
        joined: list[str] = []
        for word in args:
            if NEGATIVE.match(word) and joined and joined[-1].startswith("--") and "=" not in joined[-1]:
                joined[-1] += "=" + word
            else:
                joined.append(word)
        return super().parse_args(joined, namespace)

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}\n")


class ProgressLine:
    """One line on stderr that is written over and over; nothing when stderr is not a terminal."""

    def __init__(self) -> None:
        self._visible = sys.stderr.isatty()
        self._started = time.monotonic()
        self._last = ""
        self._asked_to_stop = False

    def ask_to_stop(self, *_signal: Any) -> None:
        """Let the next `show` raise; asked again, raise at once.

        As a signal's handler it must not raise the first time: Blender swallows what is raised while it calls Cycles, and goes on.
        """
        if self._asked_to_stop:
            raise KeyboardInterrupt
        self._asked_to_stop = True
        self._write("Stopping; Ctrl+C again stops at once")

    def show(self, progress: Progress) -> None:
        """Write the line anew where it has changed.

        Raises:
            KeyboardInterrupt: when the user has asked to stop since the last call.
        """
        if self._asked_to_stop:
            raise KeyboardInterrupt
        left = time_left(time.monotonic() - self._started, progress.fraction)
        text = f"{progress.fraction:4.0%} {progress.label}" + ("" if left is None else f", {duration(left)} left")
        self._write(text)

    def clear(self) -> None:
        """Take the line away."""
        self._write("")

    def _write(self, text: str) -> None:
        if self._visible and text != self._last:
            sys.stderr.write("\r" + text[:LINE_WIDTH].ljust(LINE_WIDTH) + ("" if text else "\r"))
            sys.stderr.flush()
            self._last = text


def given_arguments() -> list[str]:
    """What the user wrote after the script's name, or after `--` where Blender runs the script."""
    if bpy.app.module:
        return sys.argv[1:]
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []


def run(main: Callable[[list[str], ProgressLine], None]) -> NoReturn:
    """Register Farfield, call `main` with the user's arguments, and exit with the code that tells how it ended."""
    line = ProgressLine()
    signal.signal(signal.SIGINT, line.ask_to_stop)  # Blender in background mode has its own, which only stops renders
    _switch_off_installed()
    farfield.register()
    try:
        main(given_arguments(), line)
        code = DONE
    except FarfieldError as error:
        line.clear()
        print(error, file=sys.stderr)
        code = BAD_INPUT
    except KeyboardInterrupt:
        line.clear()
        print("Stopped.", file=sys.stderr)
        code = STOPPED
    finally:
        line.clear()
        farfield.unregister()
    sys.stdout.flush()
    sys.exit(code)


def write_report(path: Path, report: dict[str, Any]) -> None:
    """Write `report` as JSON, whole or not at all.

    Raises:
        FileError: when the file cannot be written.
    """
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def peak_memory_mb() -> float:
    """The most memory that this process has held, in MB of 10^6 bytes."""
    if sys.platform == "win32":
        return _peak_memory_windows() / 1e6
    import resource

    return _peak_megabytes(resource.getrusage(resource.RUSAGE_SELF))


def children_peak_memory_mb() -> float | None:
    """The most memory that any one process held which this one has started and seen end; None where the system does not tell.

    Linux counts in what this process itself held when it started them.
    """
    if sys.platform == "win32":
        return None
    import resource

    return _peak_megabytes(resource.getrusage(resource.RUSAGE_CHILDREN)) or None


def _peak_megabytes(usage: Any) -> float:
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6


def _peak_memory_windows() -> int:
    import ctypes
    from ctypes import wintypes

    class Counters(ctypes.Structure):
        _fields_ = [("size", wintypes.DWORD), ("page_faults", wintypes.DWORD)] + [
            (name, ctypes.c_size_t)
            for name in ("peak", "current", "paged_peak", "paged", "other_peak", "other", "pagefile", "pagefile_peak")
        ]

    counters = Counters(size=ctypes.sizeof(Counters))
    process = wintypes.HANDLE(ctypes.windll.kernel32.GetCurrentProcess())
    ctypes.windll.kernel32.K32GetProcessMemoryInfo(process, ctypes.byref(counters), counters.size)
    return counters.peak


def _switch_off_installed() -> None:
    """Where Farfield is also installed in this Blender, its classes would stand twice."""
    import addon_utils

    for name in list(bpy.context.preferences.addons.keys()):
        if name.endswith(".farfield"):
            addon_utils.disable(name)
