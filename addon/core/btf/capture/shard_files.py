"""Files that hold NumPy arrays of one view. A file appears complete or not at all; a checksum detects damage."""

import hashlib
import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.atomic_write import write_bytes_atomically

DIGEST_BYTES = hashlib.sha256().digest_size


@dataclass(frozen=True)
class ViewFiles:
    """Files of one kind in `folder`, one per view: NAME-0000.shard, a SHA-256 digest followed by a .npz archive."""

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
        buffer = io.BytesIO()
        save = np.savez_compressed if compressed else np.savez
        save(buffer, **arrays)
        content = buffer.getvalue()
        write_view_file(self.path(view), hashlib.sha256(content).digest() + content)

    def read(self, view: int, *names: str) -> list[np.ndarray]:
        """Return the arrays called `names` of `view`. Other arrays are not read.

        Raises:
            FileError: the file is missing or damaged.
        """
        path = self.path(view)
        try:
            with zipfile.ZipFile(path) as archive:  # finds its members despite the digest in front
                return [_read_array(archive, name) for name in names]
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise FileError(f'"{path}" cannot be read: {error}. Start the bake again; finished views are reused.') from error

    def is_valid(self, view: int) -> bool:
        """Whether the file of `view` exists and matches its checksum."""
        try:
            content = self.path(view).read_bytes()
        except OSError:
            return False
        return hashlib.sha256(content[DIGEST_BYTES:]).digest() == content[:DIGEST_BYTES]

    def remove(self, view: int) -> None:
        """Delete the file of `view` if it exists."""
        self.path(view).unlink(missing_ok=True)

    def remove_all(self) -> None:
        """Delete the files of all views."""
        for path in self.folder.glob(f"{self.name}-*.shard"):
            path.unlink(missing_ok=True)


def write_view_file(path: Path, content: bytes) -> None:
    """Write a file of a view with `write_bytes_atomically`.

    Raises:
        FileError: the file cannot be written.
    """
    try:
        write_bytes_atomically(path, content)
    except OSError as error:
        raise FileError(f'A finished view cannot be saved in "{path.parent}": {error}. Free disk space there and resume.') from error


def to_half(values: np.ndarray) -> np.ndarray:
    """Return `values` as float16, clamped to its range."""
    limit = np.finfo(np.float16).max
    return np.clip(values, -limit, limit).astype(np.float16)


def to_bytes(fractions: np.ndarray) -> np.ndarray:
    """Return `fractions` in 0..1 as uint8 in 0..255."""
    return np.rint(255.0 * np.clip(fractions, 0.0, 1.0)).astype(np.uint8)


def _read_array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    with archive.open(f"{name}.npy") as member:
        return np.lib.format.read_array(member, allow_pickle=False)
