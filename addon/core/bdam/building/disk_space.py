"""Whether the disk has room for a build, before it starts."""

import shutil
from pathlib import Path

from ...errors import FileError
from ...files.file_access import convert_os_errors

HEIGHT_BYTES = 4.0  # per sample, in the work folder
FILL_BYTES = 7.0  # per sample, of the levels of hole filling
GEOMETRY_BYTES = 16.0  # per sample: patches of two levels, coded patches, and their copy in the store
TEXEL_BYTES = {"jpeg": 2.5, "webp": 2.5, "raw": 11.0}  # per texel of the finest level: tiles, their copy in the store, pieces of one level


def estimate_bytes(samples: int, fills_holes: bool, texels: int, texture_format: str, raw_bytes: int) -> int:
    """Return about how many bytes the work folder and the store of a build take together at most.

    raw_bytes: of decoded images.
    """
    geometry = samples * (HEIGHT_BYTES + GEOMETRY_BYTES + (FILL_BYTES if fills_holes else 0.0))
    return int(geometry + texels * TEXEL_BYTES[texture_format] + raw_bytes)


def check_free_space(out: Path, needed: int, work_folder: Path) -> None:
    """Check that `needed` bytes fit on the disk of the folder `out`, beside what the work folder has already.

    Raises:
        FileError: they do not.
    """
    with convert_os_errors(f'The free space of "{out.parent}" cannot be found out'):
        place = next(parent for parent in out.absolute().parents if parent.exists())
        free = shutil.disk_usage(place).free
        kept = folder_bytes(work_folder) if work_folder.is_dir() else 0
    if needed - kept > free:
        raise FileError(
            f'The disk of "{place}" has {free / 1e9:,.2f} GB left, and the build needs about {max(needed - kept, 0) / 1e9:,.2f} GB there; '
            "free some space, or choose another disk."
        )


def folder_bytes(folder: Path) -> int:
    """Return the size of all files in a folder. Raises OSError."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
