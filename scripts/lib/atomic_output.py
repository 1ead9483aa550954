"""Output files that appear complete or not at all."""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import atomic_write


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder inside `folder`. When the block succeeds, its files are moved into `folder`.

    Raises:
        FileError: a file cannot be written, also by an operator of Blender; `folder` then has no new files.
    """
    try:
        with atomic_write.atomic_folder(folder) as temporary:
            yield temporary
    except RuntimeError as error:  # raised by Blender's operators
        raise FileError(f'Cannot write in "{folder}": {blender_error_message(error)}') from error


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield the path to write to instead of `path`; see `atomic_folder`."""
    with atomic_folder(path.parent) as folder:
        yield folder / path.name


def check_writable(*paths: Path | None) -> None:
    """Raise FileError when one of `paths` cannot be written, before any work is spent on it. Paths that are None are skipped."""
    for path in paths:
        if path is not None:
            _check_writable(path)


def _check_writable(path: Path) -> None:
    if path.is_dir():
        raise FileError(f'"{path}" is a folder; give a file name.')
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not folder.is_dir():
        raise FileError(f'Cannot write "{path}": "{folder}" is not a folder.')
    if not os.access(folder, os.W_OK):
        raise FileError(f'Cannot write "{path}": the folder "{folder}" is read-only; choose another one.')


@contextmanager
def suppress_operator_tracebacks() -> Iterator[None]:
    """Keep Blender from printing the tracebacks of operators written in Python; the operators also raise them."""
    with redirect_stderr(io.StringIO()):
        yield


def blender_error_message(error: RuntimeError) -> str:
    """Return the message of an error that a Blender operator raised: its first line, or the last line of a traceback in it."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip() and not line.startswith("Location:")]
    line = lines[-1].partition(": ")[2] if "Traceback" in str(error) else lines[0].removeprefix("Error: ")
    return line.rstrip(".") + "."
