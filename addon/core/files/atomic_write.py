"""Atomic output: files and folders that appear completely or not at all."""

import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import FileError

TEMPORARY_SUFFIX = ".part"


@contextmanager
def atomic_write(target: Path) -> Iterator[Path]:
    """Yield a temporary path to write instead of `target`, a file or a folder.

    When the block ends without an exception, the temporary file or folder is moved to `target`; otherwise it is deleted.

    Raises:
        FileError: a file cannot be written, or `target` is a folder that is not empty.
    """
    temporary = None
    try:
        check_empty(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".farfield-", dir=target.parent))
        yield temporary / target.name
        if target.is_dir():
            target.rmdir()  # not every system replaces an existing folder
        (temporary / target.name).replace(target)
    except OSError as error:
        raise FileError(f'Cannot write "{target}": {error.strerror or error}.') from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder inside `folder`. When the block ends without an exception, its files are moved into `folder`.

    Raises:
        FileError: a file cannot be written; `folder` then has no new files.
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
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def write_bytes_atomically(path: Path, content: bytes) -> None:
    """Write `content` to a temporary file beside `path` and rename it. Raises OSError.

    The temporary file has the suffix TEMPORARY_SUFFIX; a killed process leaves it behind.
    """
    temporary = path.with_suffix(f".{uuid.uuid4().hex}{TEMPORARY_SUFFIX}")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def check_empty(target: Path) -> None:
    """Raise FileError when `target` is a folder that is not empty."""
    if target.is_dir() and any(target.iterdir()):
        raise FileError(f'The folder "{target}" is not empty; choose another one or empty it.')
