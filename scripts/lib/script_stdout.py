"""A script's standard output without the messages of Blender.

Blender, its add-ons and the processes that it starts print to file descriptor 1: "Saved: ...", the statistics of Cycles, the progress of
importers. `script_stdout` sends all of that to the null device and gives the script a stream of its own.
"""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
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


def _flush() -> None:
    """Flush the buffers of Python and C, so that what Blender has printed goes where descriptor 1 points now."""
    sys.stdout.flush()
    ctypes.CDLL("ucrtbase" if os.name == "nt" else None).fflush(None)
