"""Checks of files and folders before they are read or written, and the sentences about what is wrong with them."""

import errno
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import FileError
from ..messages import single_line
from .temporary_folders import remove_abandoned_folders

ADVICE = {
    errno.ENOSPC: "free some space there",
    errno.EDQUOT: "free some space there",
    errno.EFBIG: "choose a disk that allows larger files",
    errno.EROFS: "choose another disk",
    errno.EACCES: "change its permissions or choose another path",
    errno.EPERM: "change its permissions or choose another path",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ELOOP: "choose another path",
}
MAX_ACTION = 1000  # characters of a message in front of the reason; paths that are too long to exist may have any number
OPEN_FILE = re.compile(r"/dev/(stdin|stdout|stderr|fd/\d+)|/proc/(self|\d+)/fd/\d+")  # may be a regular file that the shell has opened


def error_reason(error: OSError) -> str:
    """Return the reason of a system error on one line and what to do about it, without a period at the end."""
    lines = (error.strerror or str(error)).strip().splitlines() or [type(error).__name__]
    reason = lines[0].rstrip(".")
    return f"{reason}; {ADVICE[error.errno]}" if error.errno in ADVICE else reason


@contextmanager
def convert_os_errors(action: str) -> Iterator[None]:
    """Raise a FileError instead of an OSError in the block. `action` begins its message: `Cannot write "a.blend"`."""
    try:
        yield
    except OSError as error:
        if len(action) > MAX_ACTION:
            action = f"{action[: MAX_ACTION // 2]}...{action[-MAX_ACTION // 2 :]}"
        raise FileError(f"{action}: {error_reason(error)}.") from error


def resolve_links(path: Path) -> Path:
    """Return the absolute path that `path` refers to when its symbolic links are followed; it need not exist."""
    return Path(os.path.realpath(path))


def is_unicode(text: str) -> bool:
    """Whether `text` has no bytes that Python could not decode. Linux allows them in names of files; Blender cannot read or write these."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def check_unicode(path: Path) -> None:
    """Check that `path`, made absolute, is text without null characters.

    Raises:
        FileError: it is not.
    """
    text = str(path.absolute())
    if "\0" in text or not is_unicode(text):
        raise FileError(f'The path "{single_line(text)}" is not valid UTF-8 text; rename the file or the folder.')


def is_file(path: Path) -> bool:
    """Whether there is a regular file at `path`, through links too. For paths that somebody else has chosen: unlike `Path.is_file`, it
    raises FileError if the path cannot be one, for example because it is too long."""
    status = read_status(path)
    return status is not None and stat.S_ISREG(status.st_mode)


def is_folder(path: Path) -> bool:
    """Whether there is a folder at `path`, through links too. Raises FileError if the path cannot be one."""
    status = read_status(path)
    return status is not None and stat.S_ISDIR(status.st_mode)


def exists(path: Path) -> bool:
    """Whether there is anything at `path`, through links too. Raises FileError if the path cannot be one."""
    return read_status(path) is not None


def read_file(path: Path, max_bytes: int | None = None) -> bytes:
    """Return the content of a regular file.

    Raises:
        FileError: it is no regular file, has more than `max_bytes` bytes, or cannot be read.
    """
    check_readable(path)
    with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as file:
        content = file.read() if max_bytes is None else file.read(max_bytes + 1)
    if max_bytes is not None and len(content) > max_bytes:
        raise FileError(f'"{path}" has more than {max_bytes:,} bytes, too many for such a file; give the path of another one.')
    return content


def folder_bytes(folder: Path) -> int:
    """Return the size of all files in a folder. Raises OSError."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def check_readable(path: Path) -> None:
    """Check that `path` is a regular file that this user may read.

    Raises:
        FileError: it is not.
    """
    with convert_os_errors(f'Cannot read "{path}"'):
        status = _read_status(path)
        if status is None:
            raise FileError(f'The file "{path}" does not exist; check the path.')
        if stat.S_ISDIR(status.st_mode):
            raise FileError(f'"{path}" is a folder; give the path of a file.')
        if not stat.S_ISREG(status.st_mode):
            raise FileError(f'"{path}" is a device or a pipe; give the path of a file.')
        if not os.access(path, os.R_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def check_writable(path: Path) -> None:
    """Check that a file can be written to `path`: that a new one can be created, or the existing one replaced.

    Raises:
        FileError: it cannot.
    """
    with convert_os_errors(f'Cannot write "{path}"'):
        status = _read_status(path)
        if status is not None and stat.S_ISDIR(status.st_mode):
            raise FileError(f'"{path}" is a folder; give a file name.')
        if status is not None and not stat.S_ISREG(status.st_mode):
            raise FileError(f'"{path}" is a device or a pipe; give the path of a file.')
        if status is not None and not (status.st_mode & 0o222 and os.access(path, os.W_OK)):  # the superuser may write to any file
            raise FileError(f'The file "{path}" is read-only; make it writable or choose another path.')
        _check_parent(path)


def check_writable_folder(folder: Path) -> None:
    """Check that `folder` is empty and writable, or that it can be created.

    Raises:
        FileError: it is not, or cannot.
    """
    with convert_os_errors(f'Cannot write "{folder}"'):
        status = _read_status(folder)
        if status is not None and not stat.S_ISDIR(status.st_mode):
            raise FileError(f'"{folder}" is a file; choose another folder.')
        check_empty(folder)
        _check_parent(folder)


def check_empty(target: Path) -> None:
    """Raise FileError when `target` is a folder that is not empty. Temporary folders of processes that were killed are removed first."""
    with convert_os_errors(f'Cannot write "{target}"'):
        status = _read_status(target)
        if status is None or not stat.S_ISDIR(status.st_mode):
            return
        remove_abandoned_folders(target)
        if any(target.iterdir()):
            raise FileError(f'The folder "{target}" is not empty; choose another one or empty it.')


def is_stream(path: Path) -> bool:
    """Whether `path` is a device, a pipe or an open file of this process: it can be written to, but not replaced.

    Raises:
        FileError: the path cannot be read.
    """
    if OPEN_FILE.fullmatch(str(path.absolute())):
        return True
    with convert_os_errors(f'Cannot write "{path}"'):
        status = _read_status(path)
    return status is not None and not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode)


def read_status(path: Path) -> os.stat_result | None:
    """Return the status of the file or folder behind all links, None if there is none.

    Raises:
        FileError: the path is no text, too long, or cannot be read.
    """
    with convert_os_errors(f'Cannot use "{path}"'):
        return _read_status(path)


def has_companion(path: Path) -> bool:
    """Whether there is a regular file at a path that is made of another one. Its name may be too long for that."""
    return os.path.isfile(path)  # noqa: PTH113 - unlike `Path.is_file`, it raises no errors


def _read_status(path: Path) -> os.stat_result | None:
    """Return the status of the file behind all links, None if there is none. Raises OSError, or FileError if the path is no text."""
    check_unicode(path)
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _check_parent(path: Path) -> None:
    """Raise FileError unless something can be created in the folder of `path`, or in the nearest folder above it that exists."""
    folder = next(parent for parent in resolve_links(path).parents if os.path.lexists(parent))
    if not folder.is_dir():
        raise FileError(f'Cannot write "{path}": "{folder}" is not a folder.')
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(f'Cannot write "{path}": the folder "{folder}" is read-only; choose another one.')
