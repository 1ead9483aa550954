"""Lines of text files."""

from pathlib import Path

from ...errors import FileError
from ...files.file_access import check_readable, convert_os_errors


def read_text_lines(path: Path) -> list[str]:
    """Return the lines of a file in UTF-8, with or without a byte order mark.

    Raises:
        FileError: it cannot be read or has another encoding.
    """
    check_readable(path)
    try:
        with convert_os_errors(f'Cannot read "{path}"'):
            return path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FileError(f'"{path}" is not a text file in UTF-8; save it again.') from error
