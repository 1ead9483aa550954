"""The command line that all scripts share: arguments, progress line, reports and exit codes.

Exit codes: 0 success, 1 a defect of Farfield, 2 invalid input, 130 cancelled; in all but the first case there is one sentence on stderr.
Sentences about what is skipped or not used come before it. Standard output holds the result that `main` returns and nothing else;
`--verbose` adds the messages of Blender and the traceback of a defect. Every message is one line, whatever names it quotes.
Import this module after `environment.ensure()`.
"""

import argparse
import json
import os
import re
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TextIO

import bpy

from lib import environment

farfield = environment.import_farfield()

from farfield.addon.compat import blender_version
from farfield.addon.core.errors import FarfieldError, FileError, SettingsError
from farfield.addon.core.files.atomic_write import recorded_outputs
from farfield.addon.core.files.defect_log import defect_message, write_defect_log
from farfield.addon.core.files.file_access import convert_os_errors, error_reason, is_stream, is_unicode
from farfield.addon.core.jobs.progress import Progress, time_left
from farfield.addon.core.messages import list_first, quote_names, single_line
from farfield.addon.core.settings import Settings, flag_of, from_flags, unused_flags, with_flags
from farfield.addon.operators.job_run import format_duration
from lib.atomic_output import atomic_file
from lib.run_files import PathType, RunFiles
from lib.script_stdout import discard, script_stdout

SUCCESS, DEFECT, INVALID_INPUT, CANCELLED = 0, 1, 2, 130
SAVED = "Already saved:"  # begins the list of the outputs that are complete although the run ended early
LINE_WIDTH = 78
NEGATIVE_NUMBER = re.compile(r"-\.?\d")
STDOUT_PATH = re.compile(r"(^|(?<==))/(?:dev/stdout|dev/fd/1|proc/self/fd/1)$")  # as an argument, or as --flag=PATH
OPEN_DESCRIPTOR = re.compile(r"/(?:dev|proc/self)/fd/(\d+)")


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line. Negative numbers, and lists that begin with one, are accepted as values of flags."""

    def __init__(
        self,
        prog: str,
        description: str,
        formatter_class: Callable[[str], argparse.HelpFormatter] = argparse.HelpFormatter,
        color: bool | None = None,
    ) -> None:
        super().__init__(prog=prog, description=description, formatter_class=formatter_class)
        if color is not None:  # from Python 3.14 on, which hands it to the parsers of commands
            self.color = color
        self.add_argument("--verbose", action="store_true", help="also print the messages of Blender, its add-ons and Cycles")

    def parse_args(self, args: list[str], namespace: argparse.Namespace | None = None) -> argparse.Namespace:
        """Parse `args` and check the files that they name.

        The result has an attribute `files` with these files, but none `verbose`: `run` reads that flag.

        Raises:
            FileError: an output cannot be written, or would replace an input; see `check_outputs`.
        """
        joined: list[str] = []
        for argument in args:
            if NEGATIVE_NUMBER.match(argument) and joined and joined[-1].startswith("--") and "=" not in joined[-1]:
                joined[-1] += "=" + argument
            else:
                joined.append(argument)
        parsed = super().parse_args(joined, namespace)
        del parsed.verbose
        for name, value in vars(parsed).items():
            if isinstance(value, str) and not is_unicode(value):
                self.error(f"{flag_of(name)} is not valid UTF-8 text; write it with other characters")
        parsed.files = RunFiles()
        actions = self.path_arguments(getattr(parsed, "command", None))
        values = [(argument_name(action), action.type, getattr(parsed, action.dest)) for action in actions]
        paths = [(name, kind, path) for name, kind, value in values for path in (value if isinstance(value, list) else [value])]
        parsed.files.check_arguments([item for item in paths if item[2] is not None])
        return parsed

    def path_arguments(self, command: str | None = None) -> list[argparse.Action]:
        """Return the arguments that are paths, with those of `command` if the parser has commands."""
        parsers = [self, *self.commands(command)]
        return [action for parser in parsers for action in parser._actions if isinstance(action.type, PathType)]

    def commands(self, name: str | None) -> list[argparse.ArgumentParser]:
        """Return the parser of the command `name`; none without commands."""
        return [action.choices[name] for action in self._actions if isinstance(action, argparse._SubParsersAction)]

    def error(self, message: str) -> NoReturn:
        """Print `message` to stderr and exit with code 2."""
        self.exit(INVALID_INPUT, single_line(f"{self.prog}: {message}") + "\n")


def argument_name(action: argparse.Action) -> str:
    """Return what messages call an argument: its flag, or "the input"."""
    return action.option_strings[0] if action.option_strings else f"the {action.dest.removesuffix('s')}"


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
        self.check_cancel()
        left = time_left(time.monotonic() - self._started, progress.fraction)
        text = f"{progress.fraction:4.0%} {single_line(progress.label)}" + ("" if left is None else f", {format_duration(left)} left")
        self._write(text)

    def check_cancel(self) -> None:
        """Raise KeyboardInterrupt if the user has requested to cancel."""
        if self._cancel_requested:
            raise KeyboardInterrupt

    def clear(self) -> None:
        """Erase the line."""
        self._write("")

    def _write(self, text: str) -> None:
        if self._visible and text != self._last:
            with suppress(OSError):  # the terminal was closed
                sys.stderr.write("\r" + text[:LINE_WIDTH].ljust(LINE_WIDTH) + ("" if text else "\r"))
                sys.stderr.flush()
            self._last = text


def read_settings(arguments: argparse.Namespace, *settings_types: type[Settings]) -> dict[type[Settings], Any]:
    """Return the settings of each type that a parser built by `add_flags` has read, and warn of flags that are not used.

    Raises:
        SettingsError: a value cannot be read or is out of range.
    """
    settings = {settings_type: from_flags(settings_type, arguments) for settings_type in settings_types}
    for sentence in unused_flags(arguments, list(settings.values())):
        print_message(sentence)
    return settings


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
    verbose, wants_help = _read_output_flags(arguments)
    with script_stdout(verbose=verbose or wants_help) as stdout:
        # Descriptor 1 leads to the null device from here on.
        arguments = [STDOUT_PATH.sub(f"/dev/fd/{stdout.fileno()}", argument) for argument in arguments]
        code = _run(main, arguments, stdout, verbose)
    sys.exit(code)


def _run(main: Callable[[list[str], ProgressLine], str | None], arguments: list[str], stdout: TextIO, verbose: bool) -> int:
    """Return the exit code. An error that comes after some outputs are complete does not undo them; its message names them."""
    line = ProgressLine()
    _handle_signals(line)
    with recorded_outputs() as outputs:
        code, message = _run_main(main, arguments, line, stdout, verbose)
    if message:
        print_message(" ".join(filter(None, (message, _describe_saved(outputs)))))
    return code


def _describe_saved(outputs: list[Path]) -> str:
    """Return a sentence about the outputs that a run has written before it ended early, "" if there are none."""
    saved = [path for path in dict.fromkeys(outputs) if os.path.lexists(path)]
    return f"{SAVED} {list_first(quote_names([path]) for path in saved)}." if saved else ""


def _run_main(
    main: Callable[[list[str], ProgressLine], str | None], arguments: list[str], line: ProgressLine, stdout: TextIO, verbose: bool
) -> tuple[int, str]:
    """Return the exit code, and the message of an error."""
    script = Path(main.__code__.co_filename).name
    try:
        _disable_installed_extension()
        farfield.register()
        try:
            result = main(arguments, line)
        finally:
            line.clear()
            farfield.unregister()
        if result is not None:
            _print_result(result, stdout)
        return SUCCESS, ""
    except FarfieldError as error:
        return INVALID_INPUT, str(with_flags(error) if isinstance(error, SettingsError) else error)
    except MemoryError:
        return INVALID_INPUT, f"{script} needs more memory than there is; choose settings that need less, or give it smaller input."
    except KeyboardInterrupt:
        return CANCELLED, "Cancelled."
    except Exception as error:  # noqa: BLE001 catch-all: a defect ends in one sentence, too
        log = write_defect_log(script, error, [f"Blender {blender_version()}", f"Arguments: {arguments}"])
        if verbose:
            traceback.print_exception(error)
        return DEFECT, defect_message(script, error, log)


def _handle_signals(line: ProgressLine) -> None:
    """Let the signals that ask a process to end cancel the run, as Ctrl+C does."""
    signal.signal(signal.SIGINT, line.request_cancel)  # the handler of Blender's background mode only cancels renders
    for name in ("SIGTERM", "SIGHUP", "SIGBREAK"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:  # `nohup` ignores SIGHUP
            signal.signal(number, line.request_cancel)


def print_message(message: object) -> None:
    """Print `message` on stderr, on one line."""
    with suppress(OSError):  # nobody reads it
        print(single_line(message), file=sys.stderr, flush=True)


def _print_result(result: str, stdout: TextIO) -> None:
    """Print a result on one line, or JSON as it is: control characters in it are no part of a name.

    Raises:
        FileError: the standard output cannot be written.
    """
    try:
        json.loads(result)
    except ValueError:
        result = single_line(result)
    try:
        print(result, file=stdout, flush=True)
    except OSError as error:
        discard(stdout)
        if not isinstance(error, BrokenPipeError):  # nobody reads it
            raise FileError(f"Cannot write to the standard output: {error_reason(error)}.") from error


def _read_output_flags(arguments: list[str]) -> tuple[bool, bool]:
    """Return whether the messages of Blender are wanted, and whether the help is, which is printed to the standard output."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    known = parser.parse_known_args(arguments)[0]
    return known.verbose, known.help


def write_report(path: Path, report: dict[str, Any]) -> None:
    """Write `report` as JSON. A file appears complete or not at all; a device or a pipe is written to.

    Raises:
        FileError: the file cannot be written.
    """
    content = json.dumps(report, indent=2, allow_nan=False) + "\n"
    if is_stream(path):
        with convert_os_errors(f'Cannot write "{path}"'), _open_stream(path) as stream:
            stream.write(content)
    else:
        with atomic_file(path) as temporary:
            temporary.write_text(content, encoding="utf-8")


def _open_stream(path: Path) -> TextIO:
    """Open a device, a pipe or an open file of this process. Raises OSError."""
    descriptor = OPEN_DESCRIPTOR.fullmatch(str(path.absolute()))
    if descriptor:  # opening the path of a regular file again would start at its beginning
        return os.fdopen(os.dup(int(descriptor[1])), "w", encoding="utf-8")
    return path.open("w", encoding="utf-8")


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
