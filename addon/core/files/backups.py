"""Backups of what a whole store depends on, so that no damaged place makes it unusable.

The backup of a file `name.ending` is `name-backup.ending` in the same folder: a whole copy of the structures of terrain and textures. Of
files whose blocks are patches or texture tiles, it has only the header and the index (see `blocks`), because a damaged block costs one of
them only.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ..errors import FileError
from .file_access import convert_os_errors

SUFFIX = "-backup"

Content = TypeVar("Content")


@dataclass(frozen=True)
class FileDamage:
    """A damaged or missing part of a store that costs nothing, because it exists twice.

    path: of the damaged file. other: of the file that is used instead. is_index: whether it is only the header or the index of the file.
    """

    path: Path
    other: Path
    is_index: bool = False

    @property
    def name(self) -> str:
        """The name of the part in lists of damaged parts."""
        return f'index of "{self.path.name}"' if self.is_index else f'file "{self.path.name}"'

    @property
    def sentence(self) -> str:
        """Says what is damaged or missing and what to do."""
        part = f'The index of "{self.path}"' if self.is_index else f'"{self.path}"'
        return f'{part} is damaged or missing; nothing is lost as long as "{self.other.name}" is intact, but build the terrain again.'


def backup_path(path: Path) -> Path:
    """Return the path of the backup of a file."""
    return path.with_stem(path.stem + SUFFIX)


def copy_to_backup(path: Path) -> None:
    """Write the backup of a file as a whole copy. Raises FileError."""
    with convert_os_errors(f'Cannot write "{backup_path(path)}"'):
        shutil.copyfile(path, backup_path(path))


def read_either(path: Path, read: Callable[[Path], Content], is_index: bool = False) -> tuple[Content, tuple[FileDamage, ...]]:
    """Return what `read` returns of a file or, if that is damaged or missing, of its backup; and the damage of either, since both are read.

    is_index: whether only the header and the index of the file are read.

    Raises:
        FileError: `read` raises it for both; it is that of the file.
    """
    backup = backup_path(path)
    try:
        content = read(path)
    except FileError as error:
        try:
            return read(backup), (FileDamage(path, backup, is_index),)
        except FileError:
            raise error from None
    try:
        read(backup)
    except FileError:
        return content, (FileDamage(backup, path),)
    return content, ()
