"""The folder that a build writes a store to, and the work folder next to it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...errors import FileError
from ...files.atomic_write import TEMPORARY_SUFFIX, record_output, sync
from ...files.backups import backup_path
from ...files.file_access import check_writable, convert_os_errors, resolve_links
from ...files.temporary_folders import temporary_folder
from ...jobs.job_folder import JOB_FILE
from ...messages import list_first
from ..store.structure import STRUCTURE_FILE, find_structure
from ..store.terrain_store import GEOMETRY_FILE, NORMALS_FOLDER, TEXTURE_FOLDER
from ..textures import store as texture_store

WORK_SUFFIX, OLD_SUFFIX = ".farfield-build", ".farfield-replaced"  # hidden folders next to a store are called `.NAME.farfield-build`
STORE_FILES, TEXTURE_FILES = (
    {path.name for name in names for path in (Path(name), backup_path(Path(name)))}
    for names in ((STRUCTURE_FILE, GEOMETRY_FILE), (texture_store.STRUCTURE_FILE, texture_store.TILES_FILE))
)
SYSTEM_FILES = {".DS_Store", "Thumbs.db", "desktop.ini"}  # File managers write them into any folder.


def work_folder_path(out: Path) -> Path:
    """Return the work folder of the store `out`, next to the folder that `out` refers to."""
    return _hidden_path(out, WORK_SUFFIX)


def check_target(out: Path) -> None:
    """Check that the folder `out` is missing, empty, or a terrain, which a build replaces, and that the work folder is no other folder.

    Raises:
        FileError: it is not, or nothing can be written there.
    """
    with convert_os_errors(f'"{out}" cannot be used'):
        target = resolve_links(out)
        if not target.name:
            raise FileError(f'"{out}" cannot become a terrain; choose a folder with a name.')
        if target.exists() and not target.is_dir():
            raise FileError(f'"{out}" is a file; choose a folder for the terrain.')
        others = _find_other_files(target)
        if others:
            names = list_first(f'"{name}"' for name in others)
            raise FileError(f'"{out}" contains other files ({names}); choose an empty or a new folder for the terrain.')
        check_writable(target / STRUCTURE_FILE)
        work = work_folder_path(out)
        if not _is_work_folder(work):
            raise FileError(f'"{work}" contains other files, but the build needs that folder; rename it, or choose another name.')


def recover_store(out: Path) -> None:
    """Give a terrain its name back if a run was killed between the two renames that replace it, and it is the only one.

    Raises:
        FileError: it cannot be renamed.
    """
    target, old = resolve_links(out), _hidden_path(out, OLD_SUFFIX)
    with convert_os_errors(f'"{out}" cannot be used'):
        if not target.exists() and _is_store(old):
            old.rename(target)


@contextmanager
def replace_store(out: Path) -> Iterator[Path]:
    """Yield the path of a temporary folder that becomes `out`, or what it links to, at the end. A terrain that is there is deleted last.

    Raises:
        FileError: a folder cannot be written or renamed.
    """
    target = resolve_links(out)
    old = _hidden_path(out, OLD_SUFFIX)
    with convert_os_errors(f'"{out}" cannot be written'):
        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(target.parent) as temporary:
            new = temporary / target.name
            yield new
            sync(new)
            if _is_store(old):  # A run was killed before it could delete it.
                old.rename(temporary / "older")
            if target.is_dir():
                if old.exists():
                    raise FileError(f'"{old}" exists, but the terrain that is replaced needs that name for a moment; rename or delete it.')
                target.rename(old)
            try:
                new.rename(target)
            except OSError:
                recover_store(out)
                raise
            record_output(out)
            if _is_store(old):
                old.rename(temporary / "old")  # The end of the block deletes it, or the next run if this one is killed now.
            elif old.is_dir():
                old.rmdir()  # The folder was empty.


def delete_work_folder(folder: Path) -> None:
    """Delete a work folder that is no longer needed. If that is interrupted, no part of it is mistaken for an unfinished build.

    Raises:
        FileError: it cannot be deleted.
    """
    with convert_os_errors(f'The work folder "{folder}" cannot be deleted'), temporary_folder(folder.parent) as temporary:
        folder.rename(temporary / "build")


def _hidden_path(out: Path, suffix: str) -> Path:
    target = resolve_links(out)
    return target.with_name(f".{target.name}{suffix}")


def _is_work_folder(work: Path) -> bool:
    """Whether a build may use the folder `work`: it does not exist, is empty, or belongs to a build. Raises OSError."""
    if work.is_symlink() or not work.is_dir():
        return not os.path.lexists(work)
    return (work / JOB_FILE).exists() or all(path.suffix == TEMPORARY_SUFFIX for path in work.iterdir())


def _is_store(folder: Path) -> bool:
    """Whether a folder has the files of a terrain and nothing else."""
    return not folder.is_symlink() and find_structure(folder) is not None and not _find_other_files(folder)


def _find_other_files(folder: Path) -> list[str]:
    """Return the names of what is in a folder but is no part of a terrain. Raises OSError."""
    if not folder.is_dir():
        return []
    allowed = SYSTEM_FILES | (STORE_FILES if find_structure(folder) is not None else set())
    others = []
    for path in folder.iterdir():
        if path.name in (TEXTURE_FOLDER, NORMALS_FOLDER) and allowed > SYSTEM_FILES and path.is_dir() and not path.is_symlink():
            others += [f"{path.name}/{inner.name}" for inner in path.iterdir() if inner.name not in TEXTURE_FILES | SYSTEM_FILES]
        elif path.name not in allowed or (path.is_dir() and not path.is_symlink()):
            others.append(path.name)
    return sorted(others)
