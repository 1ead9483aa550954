"""Sealed files: a SHA-256 digest, then the content. A file appears complete or not at all, and damage to any byte is detected.

SHA-256 rather than a shorter checksum: 1.1 GB/s with the instructions that current processors have for it, faster than most disks write and
half as fast as CRC-32, which misses one in four billion damaged files. It releases the global interpreter lock.
"""

import hashlib
from pathlib import Path
from typing import BinaryIO

from ..errors import FileError
from .atomic_write import write_bytes_atomically, write_bytes_unsynced
from .file_access import convert_os_errors, error_reason

DIGEST_BYTES = hashlib.sha256().digest_size
CHUNK_BYTES = 1 << 20  # read at once for a check


def seal(content: bytes) -> bytes:
    """Return the bytes of a sealed file with this content."""
    return hashlib.sha256(content).digest() + content


def unseal(sealed: bytes) -> bytes | None:
    """Return the content of the bytes of a sealed file, None if they are damaged or incomplete."""
    content = sealed[DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == sealed[:DIGEST_BYTES] else None


def write_sealed(path: Path, content: bytes, is_durable: bool = True) -> None:
    """Write a sealed file with `write_bytes_atomically`. Equal content gives equal bytes.

    Files of which many are written, and which can be made again, need not be durable: after a power failure, their seals show which ones
    are complete.

    Raises:
        FileError: the file cannot be written.
    """
    with convert_os_errors(f'"{path}" cannot be saved'):
        write = write_bytes_atomically if is_durable else write_bytes_unsynced
        write(path, seal(content))


def read_sealed(path: Path, advice: str) -> bytes:
    """Return the content of a sealed file.

    advice: what the user can do about a file that is missing or damaged, the end of the error message: "start the build again".

    Raises:
        FileError: the file cannot be read, or is damaged.
    """
    try:
        content = unseal(path.read_bytes())
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error_reason(error)}; {advice}.') from error
    if content is None:
        raise FileError(f'"{path}" is damaged; {advice}.')
    return content


def is_valid(path: Path) -> bool:
    """Whether a sealed file exists and is undamaged. Reads it in chunks, so that files of any size need little memory."""
    try:
        with path.open("rb") as stream:
            return stream.read(DIGEST_BYTES) == _digest_rest(stream)
    except OSError:
        return False


def validate_or_remove(path: Path) -> bool:
    """Return whether a sealed file exists and is undamaged. A damaged file is deleted, so that its existence tells it from then on.

    Raises:
        FileError: it cannot be deleted.
    """
    if is_valid(path):
        return True
    with convert_os_errors(f'"{path}" is damaged and cannot be deleted'):
        path.unlink(missing_ok=True)
    return False


def _digest_rest(stream: BinaryIO) -> bytes:
    digest = hashlib.sha256()
    while chunk := stream.read(CHUNK_BYTES):
        digest.update(chunk)
    return digest.digest()
