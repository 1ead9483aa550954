"""A file of blocks of bytes, each with a checksum, read by memory mapping.

All numbers are little-endian. There is no padding: the header, the blocks in order of their numbers, and the index follow each other, so
that a changed byte anywhere is found.

| bytes | content |
|---|---|
| 0-7 | FFBLOCKS; zeros as long as the file is being written |
| 8-11 | version of this format, uint32 |
| 12-19 | kind of the file: 8 ASCII characters, chosen by its user, filled up with spaces |
| 20-27 | number of blocks N, uint64 |
| 28-35 | position of the index, uint64; the end of the last block |
| 36-39 | CRC-32 of the index, uint32 |
| 40-43 | CRC-32 of bytes 0-39, uint32 |
| 44- | the blocks |
| index | N positions, uint64; N sizes in bytes, uint32; N CRC-32 values of the blocks, uint32; the end of the file |

A backup of the index (see `backups`) is a file of its own with the same header and index without blocks between them.
"""

import mmap
import struct
import zlib
from array import array
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError
from .backups import FileDamage, backup_path, read_either
from .file_access import check_readable, convert_os_errors

MAGIC, VERSION = b"FFBLOCKS", 1
HEADER = struct.Struct("<8sI8sQQI")
CHECKSUM = struct.Struct("<I")
HEADER_SIZE = HEADER.size + CHECKSUM.size
INDEX_ENTRY_SIZE = 16  # bytes per block
MAX_BLOCK_SIZE = 2**32 - 1  # bytes


class BlockWriter(AbstractContextManager):
    """Writes blocks to a new file one after the other. Use it in a `with` block, and call `finish` at the end: a file that was not finished
    is refused by `BlockReader`."""

    def __init__(self, path: Path, kind: str) -> None:
        """Create the file, or empty it.

        kind: 1 to 8 ASCII characters that tell what the blocks are.

        Raises:
            FileError: the file cannot be written.
        """
        self._path, self._kind = path, kind.encode("ascii").ljust(8)
        if len(self._kind) != 8:
            raise ValueError(f"a kind has 1 to 8 characters, not {len(kind)}")
        self._sizes, self._checksums = array("Q"), array("Q")
        with self._convert_errors():
            self._file = path.open("wb")
            self._file.write(bytes(HEADER_SIZE))

    def __exit__(self, *_error: object) -> None:
        with self._convert_errors():
            self._file.close()

    def append(self, block: bytes | memoryview) -> int:
        """Write a block of bytes and return its number.

        Raises:
            FileError: the disk is full or not writable.
        """
        if len(block) > MAX_BLOCK_SIZE:
            raise ValueError("a block has less than 4 GiB")
        with self._convert_errors():
            self._file.write(block)
        self._sizes.append(len(block))
        self._checksums.append(zlib.crc32(block))
        return len(self._sizes) - 1

    def finish(self, backs_up_index: bool = False) -> int:
        """Write the index and the header, and close the file. Returns the checksum of the index. Raises FileError.

        backs_up_index: whether the backup of the index is written, too.
        """
        sizes = np.frombuffer(self._sizes, np.uint64) if self._sizes else np.zeros(0, np.uint64)
        ends = HEADER_SIZE + np.cumsum(sizes, dtype=np.uint64)
        checksums = np.array(self._checksums, "<u4")
        index = b"".join(((ends - sizes).astype("<u8").tobytes(), sizes.astype("<u4").tobytes(), checksums.tobytes()))
        index_position, index_checksum = int(ends[-1]) if len(sizes) else HEADER_SIZE, zlib.crc32(index)
        header = HEADER.pack(MAGIC, VERSION, self._kind, len(sizes), index_position, index_checksum)
        header += CHECKSUM.pack(zlib.crc32(header))
        with self._convert_errors():
            self._file.write(index)
            self._file.seek(0)
            self._file.write(header)
            self._file.close()
        if backs_up_index:
            backup = backup_path(self._path)
            with convert_os_errors(f'Cannot write "{backup}"'):
                backup.write_bytes(header + index)
        return index_checksum

    def _convert_errors(self) -> AbstractContextManager[None]:
        return convert_os_errors(f'Cannot write "{self._path}"')


@dataclass(frozen=True)
class _Index:
    """The index of a file: (N,) uint64 positions, (N,) uint32 sizes in bytes, (N,) uint32 checksums of blocks, and its own checksum."""

    positions: np.ndarray
    sizes: np.ndarray
    checksums: np.ndarray
    checksum: int


class BlockReader(AbstractContextManager):
    """Reads the blocks of a file, which stays mapped until `close` or the end of a `with` block. Threads may share it.

    Attributes:
        path: the file.
        sizes: (N,) uint32, bytes of the blocks.
        index_checksum: names the content of the file, since the index contains the sizes and checksums of all blocks.
        damages: those of the index or of its backup, if it has one.
    """

    def __init__(self, path: Path, kind: str, has_backup: bool = False) -> None:
        """Open a file and check its header and its index, but not its blocks.

        has_backup: whether there is a backup of the index, which is used if the header or the index is damaged.

        Raises:
            FileError: the file cannot be read, is damaged, truncated, unfinished or of a newer version, or holds blocks of another kind.
        """
        self.path = path
        self.damages: tuple[FileDamage, ...] = ()
        check_readable(path)
        if has_backup:
            index, self.damages = read_either(path, lambda source: _read_index(source, kind, source != path), is_index=True)
        else:
            index = _read_index(path, kind)
        self._positions, self.sizes, self._checksums, self.index_checksum = index.positions, index.sizes, index.checksums, index.checksum
        with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as file:
            if not file.seek(0, 2):
                raise FileError(f'"{path}" is empty; build it again.')
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    def __exit__(self, *_error: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self.sizes)

    def read(self, number: int, label: str) -> bytes:
        """Return a copy of block `number`, 0 to N - 1.

        label: names the block in an error: "texture tile 3/5/2".

        Raises:
            FileError: the block is damaged.
        """
        block = self._block(number)
        if not self._is_intact(number, block):
            raise FileError(f'The {label} in "{self.path}" is damaged; build it again, or go on without it.')
        return block

    def verify(self) -> Iterator[int]:
        """Yield the numbers of damaged blocks. Reads the whole file, one block at a time."""
        for number in range(len(self)):
            if not self._is_intact(number, self._block(number)):
                yield number

    def close(self) -> None:
        """Unmap the file."""
        self._map.close()

    def _block(self, number: int) -> bytes:
        if not 0 <= number < len(self):
            raise IndexError(f"block {number} of {len(self)}")
        start = int(self._positions[number])
        return self._map[start : start + int(self.sizes[number])]

    def _is_intact(self, number: int, block: bytes) -> bool:
        return len(block) == self.sizes[number] and zlib.crc32(block) == self._checksums[number]


def _read_index(path: Path, kind: str, is_backup: bool = False) -> _Index:
    """Return the index of a file of blocks, or that of a backup. Raises FileError."""
    check_readable(path)
    with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as file:
        header = file.read(HEADER_SIZE)
        if header.startswith(bytes(len(MAGIC))):
            raise FileError(f'"{path}" was not written to its end; build it again.')
        if len(header) < HEADER_SIZE or not header.startswith(MAGIC):
            raise FileError(f'"{path}" is no file of blocks, or its start is damaged; build it again.')
        _, version, stored_kind, count, end, index_checksum = HEADER.unpack_from(header)
        if CHECKSUM.pack(zlib.crc32(header[: HEADER.size])) != header[HEADER.size :]:
            raise FileError(f'The header of "{path}" is damaged; build it again.')
        if version > VERSION:
            raise FileError(f'"{path}" was written by a newer Farfield (version {version} of the format); update Farfield.')
        if stored_kind != kind.encode("ascii").ljust(8):
            raise FileError(f'"{path}" holds "{stored_kind.decode("latin-1").strip()}" instead of "{kind}"; give the right file.')
        position = HEADER_SIZE if is_backup else end
        if position + count * INDEX_ENTRY_SIZE != file.seek(0, 2):
            raise FileError(f'"{path}" is truncated or damaged; build it again.')
        file.seek(position)
        content = file.read()
    arrays = (np.frombuffer(content, dtype, count, start * count) for dtype, start in (("<u8", 0), ("<u4", 8), ("<u4", 12)))
    index = _Index(*arrays, index_checksum)
    boundaries = np.concatenate([index.positions, [np.uint64(end)]])
    is_contiguous = boundaries[0] == HEADER_SIZE and bool((boundaries[:-1] + index.sizes == boundaries[1:]).all())
    if zlib.crc32(content) != index_checksum or not is_contiguous:
        raise FileError(f'The index of "{path}" is damaged; build it again.')
    return index
