"""What a run may write: no output is, contains or lies in an input, and none replaces what the user did not name.

A file that the user names is replaced. Others that a run writes, such as the material file of an .obj or images in a folder, are replaced
only if Farfield wrote them.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import FileError
from .file_access import check_writable, convert_os_errors, read_status, resolve_links

Identity = str | tuple[int, int]
OBJ_COMMENT = "# Farfield\n"  # the first line of material files that Farfield writes
MAX_REFERENCE_BYTES = 1 << 16  # A file names those that belong to it near its beginning.


@dataclass(frozen=True)
class Input:
    """A file or a folder that a run reads.

    name: what messages call it, for instance "--cameras". is_closed: nothing may be written into the folder: it is a terrain or a package.
    In other folders, where a run looks files up by name, new files may be written, but none that is there is replaced.
    """

    name: str
    path: Path
    is_closed: bool = False


@dataclass(frozen=True)
class Output:
    """A file or a folder that a run writes.

    Attributes:
        name: what messages call it.
        path: where it is written.
        check: raises FileError if it cannot be written there.
        is_folder: whether it is a folder, in which files may be replaced.
        is_exclusive: of a folder: whether no other output may lie in it.
        changes: name of the input that it may be, which is then changed in place.
        is_ours: of a file that the user does not name: whether an existing one may be replaced, because an earlier run wrote it.
    """

    name: str
    path: Path
    check: Callable[[Path], None] = check_writable
    is_folder: bool = False
    is_exclusive: bool = False
    changes: str = ""
    is_ours: Callable[[Path], bool] | None = None


def check_outputs(outputs: Sequence[Output], inputs: Sequence[Input]) -> None:
    """Check before any work is done that all outputs can be written and that nothing is lost.

    Raises:
        FileError: an output cannot be written, is another output, is, contains or lies in an input, or replaces a file that neither the
            user named nor Farfield wrote.
    """
    places = {given: Place(given.path) for given in inputs}
    by_identity: dict[Identity, list[Input]] = {}
    for given, place in places.items():
        for identity in place.identities:
            by_identity.setdefault(identity, []).append(given)
    checked: dict[Output, Place] = {}
    for output in outputs:
        place = Place(output.path)
        for other, other_place in checked.items():
            _check_pair(output, place, other, other_place)
        checked[output] = place
        for given in (given for identity in place.identities for given in by_identity.get(identity, ())):
            if output.changes != given.name:
                raise FileError(f'{output.name} and {given.name} are the same file "{output.path}"; choose different files.')
        for given in (given for parent in place.path.parents for given in by_identity.get(os.path.normcase(parent), ())):
            if given.is_closed or (place.status is not None and not output.is_folder):
                raise FileError(f'{output.name} is "{output.path}" in the folder of {given.name}; choose a path outside of it.')
        if output.is_folder:
            for given, other_place in places.items():
                if place.path in other_place.path.parents:
                    raise FileError(f'{output.name} is the folder "{output.path}", which contains {given.name}; choose a new folder.')
        output.check(output.path)
        _check_ours(output)


def is_named_by(main: Path, path: Path) -> bool:
    """Whether `path` begins with OBJ_COMMENT, or the file `main` names it near its beginning, as an .obj names its materials.

    Raises:
        OSError: a file cannot be read.
    """
    with path.open("rb") as file:
        if file.read(len(OBJ_COMMENT)) == OBJ_COMMENT.encode():
            return True
    if not main.is_file():
        return False
    with main.open("rb") as file:
        return path.name.encode() in file.read(MAX_REFERENCE_BYTES)


class Place:
    """Where a path leads.

    Attributes:
        path: absolute, without links.
        status: of the file or folder there, None if there is none.
        identities: equal for two paths that lead to one file: the path, and the number of the file, for hard links and for other spellings
            where the file system ignores case.
    """

    def __init__(self, path: Path) -> None:
        """Raises FileError if the path cannot be used."""
        self.path, self.status = resolve_links(path), read_status(path)
        self.identities: set[Identity] = {os.path.normcase(self.path)}
        if self.status is not None and self.status.st_ino:
            self.identities.add((self.status.st_dev, self.status.st_ino))


def _check_pair(first: Output, place: Place, second: Output, other_place: Place) -> None:
    """Raise FileError if two outputs are the same, or one lies in the folder of the other, which is for nothing else."""
    if place.identities & other_place.identities:
        raise FileError(f'{first.name} and {second.name} are the same file "{first.path}"; choose different files.')
    for outer, outer_place, inner, inner_place in ((first, place, second, other_place), (second, other_place, first, place)):
        if outer.is_exclusive and outer_place.path in inner_place.path.parents:
            raise FileError(f'{inner.name} is "{inner.path}" in the folder of {outer.name}; choose a path outside of it.')


def _check_ours(output: Output) -> None:
    """Raise FileError if an output that the user does not name would replace a file that Farfield did not write."""
    if output.is_ours is None:
        return
    with convert_os_errors(f'Cannot read "{output.path}"'):
        is_foreign = output.path.exists() and not output.is_ours(output.path)
    if is_foreign:
        raise FileError(f'{output.name} would replace "{output.path}", which Farfield did not write; move it away or rename it.')
