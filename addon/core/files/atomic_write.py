"""Atomic output: files and folders that appear completely or not at all, also when the disk is full or the power fails."""

import errno
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from .file_access import check_writable, check_writable_folder, convert_os_errors, resolve_links
from .temporary_folders import temporary_folder

TEMPORARY_SUFFIX = ".part"
SYNC_IS_UNSUPPORTED = frozenset((errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF))  # by some network file systems
FOLDER_IS_UNREADABLE = frozenset((errno.EACCES, errno.EPERM))  # it may be writable all the same
_RECORDED: ContextVar[list[Path] | None] = ContextVar("recorded", default=None)  # by `recorded_outputs`


@contextmanager
def recorded_outputs() -> Iterator[list[Path]]:
    """Yield a list that gets the paths of all files and folders that appear within the block, in their order: an error may come after
    some outputs of a run are complete."""
    outputs: list[Path] = []
    token = _RECORDED.set(outputs)
    try:
        yield outputs
    finally:
        _RECORDED.reset(token)


def record_output(path: Path) -> None:
    """Note that an output has appeared, see `recorded_outputs`."""
    outputs = _RECORDED.get()
    if outputs is not None:
        outputs.append(path)


@contextmanager
def atomic_write(target: Path) -> Iterator[Path]:
    """Yield a temporary path to write instead of `target`, a file or a folder.

    When the block ends without an exception, the temporary file or folder is written to the disk and moved to `target`; otherwise it is
    deleted. If `target` is a symbolic link, the file that it refers to is replaced.

    Raises:
        FileError: a file cannot be written, or `target` is a folder that is not empty, a read-only file, a device or a pipe.
    """
    with convert_os_errors(f'Cannot write "{target}"'):
        _check_target(target, target.is_dir())
        destination = resolve_links(target)
        with _new_folder(destination.parent), temporary_folder(destination.parent) as folder:
            yield folder / target.name
            replace_durably(folder / target.name, destination)
            record_output(target)


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder inside `folder`. When the block ends without an exception, its files are written to the disk and moved into
    `folder`, where they replace files of the same names.

    Raises:
        FileError: a file cannot be written; `folder` then has no new files.
    """
    with convert_os_errors(f'Cannot write in "{folder}"'), _new_folder(folder), temporary_folder(folder) as temporary:
        yield temporary
        paths = sorted(temporary.iterdir())
        for path in paths:
            sync(path)
            _check_target(folder / path.name, path.is_dir())
        for path in paths:
            _move(path, folder / path.name)
        _sync_folder(folder)


@contextmanager
def _new_folder(folder: Path) -> Iterator[None]:
    """Create `folder` with those above it. If the block fails, the new ones are removed, unless there is something in them by then."""
    missing = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    folder.mkdir(parents=True, exist_ok=True)
    is_written = False
    try:
        yield
        is_written = True
    finally:
        if not is_written:
            with suppress(OSError):
                for each in missing:
                    each.rmdir()


def write_bytes_atomically(path: Path, content: bytes) -> None:
    """Write `content` to a temporary file next to `path`, then to the disk, and rename it. Raises OSError.

    The temporary file has the suffix TEMPORARY_SUFFIX; a killed process leaves it behind.
    """
    _write_bytes(path, content, replace_durably)


def write_bytes_unsynced(path: Path, content: bytes) -> None:
    """Write `content` as `write_bytes_atomically` does, but let the system choose when the disk gets it, which takes no time here.

    Killed processes leave a complete file or none, but a power failure may damage it. Raises OSError.
    """
    _write_bytes(path, content, Path.replace)


def _write_bytes(path: Path, content: bytes, replace: Callable[[Path, Path], object]) -> None:
    temporary = path.with_suffix(f".{uuid.uuid4().hex}{TEMPORARY_SUFFIX}")
    try:
        temporary.write_bytes(content)
        replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def replace_durably(source: Path, target: Path) -> None:
    """Move `source`, a file or a folder, to `target` in the same file system, replacing a file or an empty folder. Raises OSError.

    `source` is on the disk before it replaces anything: after a power failure `target` is either what it was or complete.
    """
    sync(source)
    if target.is_dir():
        target.rmdir()  # not every system replaces an existing folder
    source.replace(target)
    _sync_folder(target.parent)


def sync(path: Path) -> None:
    """Write the file `path`, or the folder `path` with all its files, from the system's cache to the disk. Raises OSError."""
    if path.is_dir():
        for child in path.iterdir():
            sync(child)
        _sync_folder(path)
    else:
        _sync(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY, SYNC_IS_UNSUPPORTED)


def _check_target(target: Path, is_folder: bool) -> None:
    """Raise FileError unless `target` can be replaced by a folder or a file."""
    if is_folder:
        check_writable_folder(target)
    else:
        check_writable(target)


def _sync_folder(folder: Path) -> None:
    """Write the names of the files in `folder` to the disk; Windows does it without being asked."""
    if os.name != "nt":
        _sync(folder, os.O_RDONLY, SYNC_IS_UNSUPPORTED | FOLDER_IS_UNREADABLE)


def _sync(path: Path, flags: int, ignored_errors: frozenset[int]) -> None:
    try:
        descriptor = os.open(path, flags)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in ignored_errors:
            raise


def _move(source: Path, target: Path) -> None:
    """Move a file that is on the disk to `target`, or to the file that the link `target` refers to."""
    destination = resolve_links(target)
    try:
        source.replace(destination)
        record_output(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with atomic_write(destination) as temporary:  # the link leads to another disk
            shutil.copyfile(source, temporary)
