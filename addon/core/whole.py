"""Files and folders that appear whole or not at all."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import FileError


@contextmanager
def whole(target: Path) -> Iterator[Path]:
    """The path to make instead of `target`, a file or a folder; it is moved there when the block ends well, else it goes.

    Raises:
        FileError: when something cannot be written, or `target` is a folder with something in it.
    """
    temporary = None
    try:
        check_vacant(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".farfield-", dir=target.parent))
        yield temporary / target.name
        if target.is_dir():
            target.rmdir()  # where a folder stands, not every system moves another one
        (temporary / target.name).replace(target)
    except OSError as error:
        raise FileError(f'Cannot write "{target}": {error.strerror or error}.') from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def check_vacant(target: Path) -> None:
    """Raise FileError when `target` is a folder with something in it."""
    if target.is_dir() and any(target.iterdir()):
        raise FileError(f'The folder "{target}" is not empty; choose another one or empty it.')
