"""What a run may write: no output is, contains or lies in an input, and none replaces what the user did not name.

A file that the user names is replaced. Others that a run writes, such as the material file of an .obj or images in a folder, are replaced
only if Farfield wrote them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import FileError
from .file_access import check_writable, convert_os_errors, is_same_file, resolve_links

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
        changes: name of the input that it may be, which is then changed in place.
        is_ours: of a file that the user does not name: whether an existing one may be replaced, because an earlier run wrote it.
    """

    name: str
    path: Path
    check: Callable[[Path], None] = check_writable
    is_folder: bool = False
    changes: str = ""
    is_ours: Callable[[Path], bool] | None = None


def check_outputs(outputs: Sequence[Output], inputs: Sequence[Input]) -> None:
    """Check before any work is done that all outputs can be written and that nothing is lost.

    Raises:
        FileError: an output cannot be written, is another output, is, contains or lies in an input, or replaces a file that neither the
            user named nor Farfield wrote.
    """
    for index, output in enumerate(outputs):
        for other in outputs[:index]:
            if is_same_file(output.path, other.path):
                raise FileError(f'{output.name} and {other.name} are the same file "{output.path}"; choose different files.')
        for given in inputs:
            _check_input(output, given)
        output.check(output.path)
        if output.is_ours is not None:
            with convert_os_errors(f'Cannot read "{output.path}"'):
                is_foreign = output.path.exists() and not output.is_ours(output.path)
            if is_foreign:
                raise FileError(f'{output.name} would replace "{output.path}", which Farfield did not write; move it away or rename it.')


def is_named_by(main: Path, path: Path) -> bool:
    """Whether the file `main` names the file `path` near its beginning, as an .obj names its materials. Raises OSError."""
    if not main.is_file():
        return False
    with main.open("rb") as file:
        return path.name.encode() in file.read(MAX_REFERENCE_BYTES)


def _check_input(output: Output, given: Input) -> None:
    """Raise FileError if an output is, contains or lies in an input."""
    if is_same_file(output.path, given.path):
        if output.changes == given.name:
            return
        raise FileError(f'{output.name} and {given.name} are the same file "{output.path}"; choose different files.')
    written, read = resolve_links(output.path), resolve_links(given.path)
    if output.is_folder and read.is_relative_to(written):
        raise FileError(f'{output.name} is the folder "{output.path}", which contains {given.name}; choose an empty or a new folder.')
    if not written.is_relative_to(read):
        return
    with convert_os_errors(f'Cannot read "{given.path}"'):
        is_lost = read.is_dir() and (given.is_closed or (written.exists() and not output.is_folder))
    if is_lost:
        raise FileError(f'{output.name} is "{output.path}" in the folder of {given.name}; choose a path outside of it.')
