"""Large arrays that are needed again and again, in memory as long as they are few, and in temporary files beyond that."""

import mmap
import shutil
from pathlib import Path
from types import TracebackType

import numpy as np

from ..errors import FileError
from .temporary_folders import create_temporary_folder

MAX_MEMORY = 256 << 20  # bytes of arrays that stay in memory
MIN_FREE = 256 << 20  # bytes that remain free on the disk


class Scratch:
    """Keeps arrays. Once they are more than `max_memory` bytes, further ones are kept in mapped files, of which the system holds in memory
    what was used last; `release` drops that, too. Arrays that are used together belong to one `group`.

    The files are deleted at the end of a `with` block; the arrays must not be used after it.
    """

    def __init__(self, max_memory: int = MAX_MEMORY) -> None:
        self._max_memory, self._kept_bytes = max_memory, 0
        self._folder: Path | None = None
        self._count = 0
        self._mapped: dict[int, list[np.memmap]] = {}

    def __enter__(self) -> "Scratch":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._mapped.clear()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def keep(self, array: np.ndarray, group: int) -> np.ndarray:
        """Return an array with the same values that may be changed, too.

        Raises:
            FileError: the disk of temporary files has too little space, or cannot be written.
        """
        if self._kept_bytes + array.nbytes <= self._max_memory or not array.nbytes:
            self._kept_bytes += array.nbytes
            return array
        try:
            if self._folder is None:
                self._folder = create_temporary_folder()
            free = shutil.disk_usage(self._folder).free
            if free < array.nbytes + MIN_FREE:
                place = self._folder.parent
                raise FileError(f'The disk of "{place}" has only {free / 1e6:,.0f} MB left; free some space, or use fewer images.')
            path = self._folder / str(self._count)
            array.tofile(path)
            mapped = np.memmap(path, array.dtype, "r+", shape=array.shape)
        except OSError as error:
            raise FileError(f"A temporary file cannot be written ({error.strerror}); free some space on that disk.") from error
        self._count += 1
        self._mapped.setdefault(group, []).append(mapped)
        return mapped

    def release(self, group: int) -> None:
        """Drop the mapped files of a group from the memory of the process; they are read again when they are needed."""
        if hasattr(mmap, "MADV_DONTNEED"):  # not on Windows, which limits the memory of a process by itself
            for mapped in self._mapped.get(group, ()):
                mapped._mmap.madvise(mmap.MADV_DONTNEED)
