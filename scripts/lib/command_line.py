"""The command line that all scripts share: arguments, progress line, reports and exit codes.

Exit codes: 0 success, 2 invalid input (an error message of one sentence on stderr), 130 cancelled. Standard output holds the result that
`main` returns and nothing else; `--verbose` adds the messages of Blender. Import this module after `environment.ensure()`.
"""

import argparse
import json
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, TextIO

import bpy

from lib import environment

farfield = environment.import_farfield()

from farfield.addon.core.errors import FarfieldError, SettingsError
from farfield.addon.core.jobs.progress import Progress, time_left
from farfield.addon.core.settings import with_flags
from farfield.addon.operators.long_work import format_duration
from lib.atomic_output import atomic_file
from lib.script_stdout import script_stdout

SUCCESS, INVALID_INPUT, CANCELLED = 0, 2, 130
LINE_WIDTH = 78
NEGATIVE_NUMBER = re.compile(r"-\.?\d")


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line. Negative numbers, and lists that begin with one, are accepted as values of flags."""

    def __init__(
        self, prog: str, description: str, formatter_class: Callable[[str], argparse.HelpFormatter] = argparse.HelpFormatter
    ) -> None:
        super().__init__(prog=prog, description=description, formatter_class=formatter_class)
        self.add_argument("--verbose", action="store_true", help="also print the messages of Blender, its add-ons and Cycles")

    def parse_args(self, args: list[str], namespace: argparse.Namespace | None = None) -> argparse.Namespace:
        """Parse `args`. The result has no attribute `verbose`: `run` reads that flag."""
        joined: list[str] = []
        for argument in args:
            if NEGATIVE_NUMBER.match(argument) and joined and joined[-1].startswith("--") and "=" not in joined[-1]:
                joined[-1] += "=" + argument
            else:
                joined.append(argument)
        parsed = super().parse_args(joined, namespace)
        del parsed.verbose
        return parsed

    def error(self, message: str) -> NoReturn:
        """Print `message` to stderr and exit with code 2."""
        self.exit(INVALID_INPUT, f"{self.prog}: {message}\n")


class ProgressLine:
    """One line on stderr that is overwritten as the work proceeds. Prints nothing unless stderr is a terminal."""

    def __init__(self) -> None:
        self._visible = sys.stderr.isatty()
        self._started = time.monotonic()
        self._last = ""
        self._cancel_requested = False

    def request_cancel(self, *_signal: Any) -> None:
        """Let the next `show` raise KeyboardInterrupt; on the second call, raise it immediately.

        This is a signal handler. It must not raise on the first call: Blender swallows exceptions while it calls Cycles, and continues.
        """
        if self._cancel_requested:
            raise KeyboardInterrupt
        self._cancel_requested = True
        self._write("Cancelling; press Ctrl+C again to abort immediately")

    def show(self, progress: Progress) -> None:
        """Overwrite the line if its text has changed.

        Raises:
            KeyboardInterrupt: the user has requested to cancel since the last call.
        """
        if self._cancel_requested:
            raise KeyboardInterrupt
        left = time_left(time.monotonic() - self._started, progress.fraction)
        text = f"{progress.fraction:4.0%} {progress.label}" + ("" if left is None else f", {format_duration(left)} left")
        self._write(text)

    def clear(self) -> None:
        """Erase the line."""
        self._write("")

    def _write(self, text: str) -> None:
        if self._visible and text != self._last:
            sys.stderr.write("\r" + text[:LINE_WIDTH].ljust(LINE_WIDTH) + ("" if text else "\r"))
            sys.stderr.flush()
            self._last = text


def script_arguments() -> list[str]:
    """Return the user's arguments: those after the script's name, or after `--` where Blender runs the script."""
    if bpy.app.module:
        return sys.argv[1:]
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []


def run(main: Callable[[list[str], ProgressLine], str | None]) -> NoReturn:
    """Register Farfield, call `main` with the user's arguments, print the result that it returns, and exit.

    The result is one line; benchmarks return JSON. Error messages go to stderr.
    """
    arguments = script_arguments()
    with script_stdout(verbose=_keeps_stdout(arguments)) as stdout:
        code = _run(main, arguments, stdout)
    sys.exit(code)


def _run(main: Callable[[list[str], ProgressLine], str | None], arguments: list[str], stdout: TextIO) -> int:
    """Return the exit code."""
    line = ProgressLine()
    signal.signal(signal.SIGINT, line.request_cancel)  # the handler of Blender's background mode only cancels renders
    _disable_installed_extension()
    farfield.register()
    try:
        result = main(arguments, line)
        line.clear()
        if result is not None:
            print(result, file=stdout)
        return SUCCESS
    except FarfieldError as error:
        line.clear()
        print(with_flags(error) if isinstance(error, SettingsError) else error, file=sys.stderr)
        return INVALID_INPUT
    except KeyboardInterrupt:
        line.clear()
        print("Cancelled.", file=sys.stderr)
        return CANCELLED
    finally:
        line.clear()
        farfield.unregister()


def _keeps_stdout(arguments: list[str]) -> bool:
    """Whether the standard output is left alone: `--verbose` asks for the messages of Blender, and `--help` prints to it."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    known = parser.parse_known_args(arguments)[0]
    return known.verbose or known.help


def write_report(path: Path, report: dict[str, Any]) -> None:
    """Write `report` as JSON. The file appears complete or not at all.

    Raises:
        FileError: the file cannot be written.
    """
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def peak_memory_mb() -> float:
    """Return the peak memory of this process in MB (10^6 bytes)."""
    if sys.platform == "win32":
        return _peak_memory_windows() / 1e6
    import resource

    return _peak_megabytes(resource.getrusage(resource.RUSAGE_SELF))


def children_peak_memory_mb() -> float | None:
    """Return the largest peak memory among the finished child processes in MB (10^6 bytes), None where the system does not report it.

    On Linux it includes the memory of this process at the time when it started the child.
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


def _disable_installed_extension() -> None:
    """Disable a Farfield that is also installed in this Blender; its classes would be registered twice."""
    import addon_utils

    for name in list(bpy.context.preferences.addons.keys()):
        if name.endswith(".farfield"):
            addon_utils.disable(name)
