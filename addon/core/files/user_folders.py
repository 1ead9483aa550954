"""Folders of the user: the cache for data that can be computed again, and folders that only their owner may enter."""

import os
import stat
import sys
from pathlib import Path

from ..errors import FileError
from .file_access import convert_os_errors

FOLDER_NAME = "farfield"
OWNER_ONLY = 0o700


def user_cache_folder() -> Path:
    """Return the folder of Farfield in the user's cache, by the convention of the platform. It may not exist yet.

    Raises:
        FileError: the user has no home folder.
    """
    try:
        if sys.platform == "win32":
            base = _absolute_path("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        elif sys.platform == "darwin":
            base = Path.home() / "Library" / "Caches"
        else:
            base = _absolute_path("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError as error:
        raise FileError("There is no home folder for temporary data; set the environment variable HOME.") from error
    return base / FOLDER_NAME


def open_private_folder(folder: Path) -> None:
    """Create `folder` with access for this user only, or withdraw the access of others from an existing folder of this user.

    On Windows the access rights of the folder above apply.

    Raises:
        FileError: it is a link or not a folder, belongs to another user, or cannot be created.
    """
    with convert_os_errors(f'Cannot use the folder "{folder}"'):
        folder.parent.mkdir(parents=True, exist_ok=True)
        if not os.path.lexists(folder):
            folder.mkdir(mode=OWNER_ONLY, exist_ok=True)
        if folder.is_symlink():
            raise FileError(f'"{folder}" is a link; remove it or choose another folder.')
        if not folder.is_dir():
            raise FileError(f'"{folder}" is a file; choose a folder.')
        check_owner(folder)
        if hasattr(os, "fchmod"):
            _withdraw_access(folder)


def check_owner(folder: Path) -> None:
    """Raise FileError if `folder` belongs to another user, who could replace its contents. On Windows access rights prevent that."""
    with convert_os_errors(f'Cannot use the folder "{folder}"'):
        _check_owner(folder, folder.stat())


def _withdraw_access(folder: Path) -> None:
    """Withdraw the access of others. Raises OSError for a link, FileError if another user has replaced the folder."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        status = os.fstat(descriptor)
        _check_owner(folder, status)
        if stat.S_IMODE(status.st_mode) & ~OWNER_ONLY:
            os.fchmod(descriptor, OWNER_ONLY)
    finally:
        os.close(descriptor)


def _check_owner(folder: Path, status: os.stat_result) -> None:
    if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
        raise FileError(f'The folder "{folder}" belongs to another user; choose a folder of your own.')


def _absolute_path(variable: str) -> Path | None:
    """Return the path in an environment variable, or None if it is unset or relative."""
    path = Path(os.environ.get(variable, ""))
    return path if path.is_absolute() else None
