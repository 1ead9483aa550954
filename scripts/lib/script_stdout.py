"""A script's standard output and standard error without the messages of Blender.

Blender, its add-ons and the processes that it starts print to file descriptor 1: "Saved: ...", the statistics of Cycles, the progress of
importers. `script_stdout` sends all of that to the null device and gives the script a stream of its own. `mute_stderr` does the same with
descriptor 2, for operators that print the reasons of errors that they also raise.
"""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TextIO


@contextmanager
def script_stdout(verbose: bool = False) -> Iterator[TextIO]:
    """Yield a stream to the standard output, which nothing else reaches within the block unless `verbose`.

    `sys.stdout` and file descriptor 1, which child processes inherit, are restored when the block ends, also by an exception.
    """
    original = os.dup(1)
    with os.fdopen(original, "w", encoding=sys.stdout.encoding, errors="backslashreplace") as stream:
        try:
            with nullcontext() if verbose else _muted(original):
                yield stream
        finally:
            _flush()  # before `stream`, so that the result is the last line


@contextmanager
def _muted(original: int) -> Iterator[None]:
    """Redirect file descriptor 1 and `sys.stdout` to the null device within the block; `original` is a duplicate of the descriptor."""
    _flush()
    with Path(os.devnull).open("w", encoding="utf-8") as null:
        os.dup2(null.fileno(), 1)
        try:
            with redirect_stdout(null):  # on a Windows console, sys.stdout does not follow its descriptor
                yield
        finally:
            _flush()
            os.dup2(original, 1)


@contextmanager
def mute_stderr() -> Iterator[None]:
    """Send what Blender, its libraries and add-ons print to stderr within the block to the null device."""
    _flush()
    original = os.dup(2)
    try:
        with Path(os.devnull).open("w", encoding="utf-8") as null:
            os.dup2(null.fileno(), 2)
            try:
                with redirect_stderr(null):
                    yield
            finally:
                _flush()
                os.dup2(original, 2)
    finally:
        os.close(original)


def discard(stream: TextIO) -> None:
    """Send what `stream` could not write, and all that follows, to the null device. Otherwise closing it would fail again."""
    with Path(os.devnull).open("w", encoding="utf-8") as null:
        os.dup2(null.fileno(), stream.fileno())


def _flush() -> None:
    """Flush the buffers of Python and C, so that what Blender has printed goes where descriptors 1 and 2 point now."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:  # nobody reads it
            discard(stream)
    ctypes.CDLL("ucrtbase" if os.name == "nt" else None).fflush(None)
