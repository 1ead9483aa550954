"""Names of numbered files: the tiles of a UDIM texture, `wood.<UDIM>.png`, or the frames of a sequence, `frame_####.png`."""

import re
from pathlib import Path

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from farfield.addon.core.files.file_access import convert_os_errors

UDIM = "<UDIM>"
PLACEHOLDER = re.compile(r"<UDIM>|#+")
FIRST_UDIM = 1001


def find_placeholder(path: Path) -> str | None:
    """Return the placeholder in the name of `path`, `<UDIM>` or a run of "#", or None if there is none or a file has just this name.

    Raises:
        FileError: the name contains several placeholders, or the file cannot be accessed.
    """
    found = PLACEHOLDER.findall(path.name)
    with convert_os_errors(f'Cannot read "{path}"'):
        if not found or path.exists():
            return None
    if len(found) > 1:
        raise FileError(f'"{path}" contains several placeholders; use {UDIM} or one run of # once.')
    return found[0]


def find_numbers(path: Path, placeholder: str) -> list[int]:
    """Return the numbers of the existing files that `path` with this placeholder stands for, in ascending order.

    Raises:
        FileError: there is none, or the folder cannot be read.
    """
    start, _, end = path.name.partition(placeholder)
    pattern = re.compile(re.escape(start) + r"(\d+)" + re.escape(end))
    with convert_os_errors(f'Cannot read "{path}"'):
        names = [file.name for file in path.parent.iterdir()]
    numbers = {int(match[1]) for match in map(pattern.fullmatch, names) if match is not None}
    numbers = {number for number in numbers if (number >= FIRST_UDIM if placeholder == UDIM else True)}
    existing = sorted(number for number in numbers if numbered_path(path, placeholder, number).name in names)
    if not existing:
        raise FileError(f'No file matches "{path}", with a number instead of {placeholder}; check the path.')
    return existing


def numbered_path(path: Path, placeholder: str, number: int) -> Path:
    """Return `path` with the number in place of the placeholder, with at least as many digits as it has characters "#"."""
    digits = 4 if placeholder == UDIM else len(placeholder)
    return path.with_name(path.name.replace(placeholder, f"{number:0{digits}d}"))
