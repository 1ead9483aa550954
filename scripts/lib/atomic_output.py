"""Output files that appear complete or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import atomic_write


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder inside `folder`. When the block succeeds, its files are moved into `folder`.

    Raises:
        FileError: a file cannot be written, also by an operator of Blender; `folder` then has no new files.
    """
    with _convert_operator_errors(f'Cannot write in "{folder}"'), atomic_write.atomic_folder(folder) as temporary:
        yield temporary


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield the path to write to instead of `path`. When the block succeeds, the file is moved to `path`.

    Raises:
        FileError: the file cannot be written, also by an operator of Blender; `path` is then as before.
    """
    with _convert_operator_errors(f'Cannot write "{path}"'), atomic_write.atomic_write(path) as temporary:
        yield temporary


@contextmanager
def _convert_operator_errors(action: str) -> Iterator[None]:
    """Raise a FileError instead of a RuntimeError of a Blender operator in the block. `action` begins its message."""
    try:
        yield
    except RuntimeError as error:
        if type(error) is not RuntimeError:
            raise  # a defect of Python code, such as unlimited recursion
        raise FileError(f"{action}: {blender_error_message(error)}") from error


def blender_error_message(error: RuntimeError) -> str:
    """Return the message of an error that a Blender operator raised: its first line, or the last line of a traceback in it."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip() and not line.startswith("Location:")]
    if not lines:
        return "Blender gives no reason."
    line = lines[-1].partition(": ")[2] if "Traceback" in str(error) else lines[0].removeprefix("Error: ")
    return (line or lines[-1]).rstrip(".") + "."
