"""Files that hold NumPy arrays of one view, and their encoding. A file appears complete or not at all; a checksum detects damage."""

import io
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.atomic_write import write_bytes_atomically
from ...files.file_access import error_reason
from ...files.sealed_files import seal, unseal
from .array_archives import READ_ERRORS, read_archive, write_archive

UNKNOWN = 255
FULLY_VISIBLE = UNKNOWN - 1


@dataclass(frozen=True)
class ViewFiles:
    """Files of one kind in `folder`, one per view: NAME-0000.shard, a sealed .npz archive."""

    folder: Path
    name: str

    def path(self, view: int) -> Path:
        """Return the path of the file of `view`."""
        return self.folder / f"{self.name}-{view:04d}.shard"

    def write(self, view: int, arrays: dict[str, np.ndarray], *, compressed: bool = False) -> None:
        """Write `arrays` as the file of `view`.

        Raises:
            FileError: the file cannot be written.
        """
        write_view_file(self.path(view), seal(write_archive(arrays, compressed=compressed)))

    def read(self, view: int, *names: str) -> list[np.ndarray]:
        """Return the arrays called `names` of `view`. Other arrays are not read.

        Raises:
            FileError: the file is missing or damaged.
        """
        path = self.path(view)
        try:
            with path.open("rb") as stream:
                return read_archive(stream, *names)
        except READ_ERRORS as error:
            reason = error_reason(error) if isinstance(error, OSError) else error
            raise FileError(f'"{path}" cannot be read: {reason}. Start the bake again; finished views are reused.') from error

    def read_valid(self, view: int, *names: str) -> list[np.ndarray] | None:
        """Return the arrays called `names` of `view`, or None unless the file exists, matches its checksum and contains them."""
        try:
            content = unseal(self.path(view).read_bytes())
            return None if content is None else read_archive(io.BytesIO(content), *names)
        except READ_ERRORS:
            return None

    def remove(self, view: int) -> None:
        """Delete the file of `view` if it exists.

        Raises:
            FileError: it cannot be deleted.
        """
        try:
            self.path(view).unlink(missing_ok=True)
        except OSError as error:
            raise FileError(f'"{self.path(view)}" cannot be deleted: {error_reason(error)}; remove it and start the bake again.') from error

    def remove_all(self) -> None:
        """Delete the files of all views, as far as they can be deleted."""
        for path in self.folder.glob(f"{self.name}-*.shard"):
            with suppress(OSError):
                path.unlink()


def write_view_file(path: Path, content: bytes) -> None:
    """Write a file of a view with `write_bytes_atomically`.

    Raises:
        FileError: the file cannot be written.
    """
    try:
        write_bytes_atomically(path, content)
    except OSError as error:
        raise FileError(f'Finished views are kept, but this one cannot be saved as "{path}": {error_reason(error)}.') from error


def to_half(values: np.ndarray) -> np.ndarray:
    """Return `values` as float16, clamped to its range."""
    limit = np.finfo(np.float16).max
    return np.clip(values, -limit, limit).astype(np.float16)


def encode_visibility(visible: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return the visible fraction (N,) uint8 of texels, 0 to FULLY_VISIBLE; UNKNOWN where nothing of a texel was seen.

    visible, hidden (N,): numbers of subsamples that a light sees, and that other surfaces hide from it.
    """
    total = visible + hidden
    return np.where(total > 0.0, np.rint((UNKNOWN - 1) * visible / np.maximum(total, 1.0)), UNKNOWN).astype(np.uint8)
