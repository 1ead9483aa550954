"""Files that appear whole or not at all."""

import io
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path

import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder beside the files of `folder`; what the block leaves in it is moved there in one go when the block ends well.

    Raises:
        FileError: when something cannot be written. Then nothing new stands in `folder`.
    """
    temporary = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".farfield-", dir=folder))
        yield temporary
        for path in sorted(temporary.iterdir()):
            path.replace(folder / path.name)
    except OSError as error:
        raise FileError(f'Cannot write in "{folder}": {error.strerror or error}.') from error
    except RuntimeError as error:  # what Blender's operators raise
        raise FileError(f'Cannot write in "{folder}": {said_by_blender(error)}') from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """The path to write to instead of `path`; see `whole_folder`."""
    with whole_folder(path.parent) as folder:
        yield folder / path.name


def check_writable(*paths: Path | None) -> None:
    """Raise FileError when one of `paths` cannot be made, before any work is spent on it; those that were not asked for are None."""
    for path in paths:
        if path is not None:
            _check_writable(path)


def _check_writable(path: Path) -> None:
    if path.is_dir():
        raise FileError(f'"{path}" is a folder; give the name of a file.')
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not folder.is_dir():
        raise FileError(f'Cannot write "{path}": "{folder}" is not a folder.')
    if not os.access(folder, os.W_OK):
        raise FileError(f'Cannot write "{path}": the folder "{folder}" is read-only; choose another one.')


@contextmanager
def quiet_operators() -> Iterator[None]:
    """Operators written in Python raise what went wrong and Blender prints it as well; within this block it does not print."""
    with redirect_stderr(io.StringIO()):
        yield


def said_by_blender(error: RuntimeError) -> str:
    """One sentence out of what a Blender operator raised: its first line, or the last one of a traceback within."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip() and not line.startswith("Location:")]
    line = lines[-1].partition(": ")[2] if "Traceback" in str(error) else lines[0].removeprefix("Error: ")
    return line.rstrip(".") + "."
