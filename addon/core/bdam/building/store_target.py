"""The folder that a build writes a store to, and the work folder next to it."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import FileError
from ...files.atomic_write import TEMPORARY_SUFFIX, atomic_write
from ...files.file_access import convert_os_errors
from ...jobs.job_folder import JOB_FILE
from ..store.structure import STRUCTURE_FILE, find_structure

WORK_SUFFIX, NEW_SUFFIX, OLD_SUFFIX = ".build", ".new", ".build-finished"  # added to the name of the store's folder


def work_folder_path(out: Path) -> Path:
    """Return the work folder of the store `out`."""
    return out.with_name(out.name + WORK_SUFFIX)


def check_target(out: Path) -> None:
    """Check that the folder `out` is missing, empty, or a terrain, which a build replaces, and that the work folder is no other folder.

    Raises:
        FileError: it is not.
    """
    with convert_os_errors(f'"{out}" cannot be used'):
        if not out.name:
            raise FileError(f'"{out}" cannot become a terrain; choose a folder with a name.')
        if out.exists() and not out.is_dir():
            raise FileError(f'"{out}" is a file; choose a folder for the terrain.')
        if out.is_dir() and find_structure(out) is None and any(out.iterdir()):
            raise FileError(f'"{out}" contains other files; choose an empty or a new folder for the terrain.')
        work = work_folder_path(out)
        if work.is_dir() and not (work / JOB_FILE).exists() and any(path.suffix != TEMPORARY_SUFFIX for path in work.iterdir()):
            raise FileError(f'"{work}" contains other files, but the build needs that folder; rename it, or choose another name.')


@contextmanager
def replace_store(out: Path) -> Iterator[Path]:
    """Yield a temporary folder that becomes `out` at the end. A terrain that was there before is deleted then.

    Raises:
        FileError: a folder cannot be written or deleted.
    """
    new = out.with_name(out.name + NEW_SUFFIX)
    with convert_os_errors(f'"{new}" cannot be deleted'):
        if (new / STRUCTURE_FILE).exists():  # a build was interrupted just before it replaced the terrain
            shutil.rmtree(new)
    with atomic_write(new) as temporary:
        yield temporary
    with convert_os_errors(f'The terrain is finished in "{new}", but "{out}" cannot be replaced'):
        if out.exists():
            shutil.rmtree(out)
        new.rename(out)


def delete_work_folder(folder: Path) -> None:
    """Delete a work folder that is no longer needed. If that is interrupted, no part of it is mistaken for an unfinished build.

    Raises:
        FileError: it cannot be deleted.
    """
    old = folder.with_name(folder.name.removesuffix(WORK_SUFFIX) + OLD_SUFFIX)
    with convert_os_errors(f'The work folder "{folder}" cannot be deleted'):
        if old.exists():
            shutil.rmtree(old)
        folder.rename(old)
        shutil.rmtree(old)
