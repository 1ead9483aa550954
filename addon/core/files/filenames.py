"""File names made of arbitrary names, such as those of data-blocks, that are valid on Linux, macOS and Windows."""

import unicodedata
from collections.abc import Sequence
from pathlib import Path

MAX_FILENAME_BYTES = 100  # UTF-8; leaves room for prefixes and suffixes below the 255 that file systems allow
RESERVED_CHARACTERS = frozenset('<>:"/\\|?*')  # separators, and characters that Windows does not allow
UNPRINTABLE_CATEGORIES = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))  # control, format, surrogate, line and paragraph separators
DEVICE_NAMES = frozenset(  # Windows reserves these names, with any extension.
    ["con", "prn", "aux", "nul", "conin$", "conout$"] + [f"{port}{digit}" for port in ("com", "lpt") for digit in "0123456789¹²³"]
)
REPLACEMENT = "_"
UNNAMED = "unnamed"


def safe_filename(name: str) -> str:
    """Return a file name without folders that resembles `name`: at most MAX_FILENAME_BYTES long in UTF-8, never empty, "." or "..".

    Separators, control characters, line breaks and the characters that Windows does not allow become "_". Dots and spaces at both ends are
    removed, so the file is not hidden. The device names of Windows get a "_" in front. A safe file name is returned unchanged.
    """
    characters = (REPLACEMENT if _is_reserved(character) else character for character in name)
    safe = _strip(_truncate(_strip("".join(characters)), MAX_FILENAME_BYTES)) or UNNAMED
    if safe.partition(".")[0].rstrip(" ").lower() in DEVICE_NAMES:
        safe = _strip(_truncate(REPLACEMENT + safe, MAX_FILENAME_BYTES))
    return safe


def unique_filenames(names: Sequence[str]) -> list[str]:
    """Return one safe file name per name. Names that are alike, also in another case, get the suffixes "_2", "_3", ... in their order."""
    taken: set[str] = set()
    filenames = []
    for name in names:
        filename, number = safe_filename(name), 1
        while _comparison_key(filename) in taken:
            number += 1
            suffix = f"{REPLACEMENT}{number}"
            filename = _strip(_truncate(safe_filename(name), MAX_FILENAME_BYTES - len(suffix))) + suffix
        taken.add(_comparison_key(filename))
        filenames.append(filename)
    return filenames


def material_path(path: Path) -> Path:
    """Return the path of the `.mtl` file of an `.obj` file."""
    return path.with_name(f"{safe_filename(path.stem)}.mtl")


def _is_reserved(character: str) -> bool:
    return character in RESERVED_CHARACTERS or unicodedata.category(character) in UNPRINTABLE_CATEGORIES


def _strip(name: str) -> str:
    return name.strip(". ")


def _truncate(name: str, max_bytes: int) -> str:
    """Return the longest beginning of `name` that has at most `max_bytes` bytes in UTF-8."""
    return name.encode()[:max_bytes].decode(errors="ignore")


def _comparison_key(filename: str) -> str:
    """Return a key that is equal for file names that some file system treats as the same."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", filename).casefold())
