"""Files of patches between the levels of a build. Each has one section for every shard of the next coarser level that needs some of the
patches, so that every patch is read once only.

A file is sealed, and so is each section, because readers see one section only. Its content: the number of sections and, for each, its shard
and its end, counted from the end of this table, as little-endian int64; then the sections.
"""

import io
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.file_access import error_reason
from ...files.sealed_files import DIGEST_BYTES, seal, unseal, write_sealed
from .patch_set import PatchSet
from .work_folder import ADVICE

INTEGER = np.dtype("<i8")


def write_patches(path: Path, patches: PatchSet, shards: np.ndarray) -> None:
    """Write patches for the `shards` (P,) int64 of the next coarser level that need them.

    The system may still hold the file in its cache: if the power fails, its seal shows whether it is complete.

    Raises:
        FileError: the file cannot be written.
    """
    sections = []
    numbers = np.unique(shards)
    for shard in numbers:
        stream = io.BytesIO()
        patches.select(np.flatnonzero(shards == shard)).save(stream)
        sections.append(seal(stream.getvalue()))
    ends = np.cumsum([len(section) for section in sections])
    table = np.concatenate([[len(sections)], np.stack([numbers, ends], axis=1).reshape(-1)]).astype(INTEGER)
    write_sealed(path, b"".join([table.tobytes(), *sections]), is_durable=False)


def read_patches(path: Path, shard: int) -> PatchSet:
    """Read the patches that a shard of the next coarser level needs.

    Raises:
        FileError: the file cannot be read, is damaged, or has no such patches.
    """
    content = None
    try:
        with path.open("rb") as file:
            file.seek(DIGEST_BYTES)
            size = path.stat().st_size - DIGEST_BYTES
            count = int.from_bytes(file.read(INTEGER.itemsize), "little", signed=True)
            if 0 < count <= size // (2 * INTEGER.itemsize):
                table = np.frombuffer(file.read(2 * INTEGER.itemsize * count), INTEGER).reshape(-1, 2)
                found = np.flatnonzero(table[:, 0] == shard)
                if len(found):
                    start, end = 0 if found[0] == 0 else int(table[found[0] - 1, 1]), int(table[found[0], 1])
                    if 0 <= start <= end <= size:
                        file.seek(start, io.SEEK_CUR)
                        content = unseal(file.read(end - start))
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error_reason(error)}; {ADVICE}.') from error
    if content is None:
        raise FileError(f'"{path}" is damaged; {ADVICE}.')
    return PatchSet.load(io.BytesIO(content))
