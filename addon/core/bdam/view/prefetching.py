"""Reading ahead: fills caches with what will be needed soon, in memory that the present does not need."""

from collections.abc import Hashable, Iterable
from typing import Protocol

from ...errors import FarfieldError
from ...jobs.progress import Progress, Steps
from ..store.terrain_store import TerrainStore
from .cut_meshes import PatchCache
from .texture_files import TextureFiles

VERTEX_BYTES, TRIANGLE_BYTES = 48, 12  # of a `PatchMesh`, at most


class ReadAhead(Protocol):
    """A cache that keeps what was used last. max_bytes: that it may keep."""

    max_bytes: int

    def read(self, key: Hashable) -> None:
        """Read an item that is not there. Raises FarfieldError if it is damaged."""

    def touch(self, key: Hashable) -> int | None:
        """Keep an item as if it had just been used. Returns its bytes, None if it is not there."""

    def bound_bytes(self, key: Hashable) -> int:
        """Return at least the bytes of an item that is not there."""


class PatchesAhead:
    """Patches, by level, row, and whether only the outline is shown, as a `ReadAhead`."""

    def __init__(self, store: TerrainStore, cache: PatchCache) -> None:
        self._store, self._cache, self.max_bytes = store, cache, cache.max_bytes

    def read(self, key: tuple[int, int, bool]) -> None:
        """See `ReadAhead`."""
        self._cache.get(*key)

    def touch(self, key: tuple[int, int, bool]) -> int | None:
        """See `ReadAhead`."""
        return self._cache.touch(*key)

    def bound_bytes(self, key: tuple[int, int, bool]) -> int:
        """See `ReadAhead`."""
        level, row, is_outline = key
        vertices, triangles, outline_triangles = self._store.levels[level].counts[row].tolist()
        if is_outline and outline_triangles < triangles:
            vertices, triangles = outline_triangles + 2, outline_triangles
        return VERTEX_BYTES * vertices + TRIANGLE_BYTES * triangles


class TexturesAhead:
    """Texture tiles, by number, as a `ReadAhead`."""

    def __init__(self, files: TextureFiles) -> None:
        self._files, self.max_bytes = files, files.max_bytes
        self.touch, self.bound_bytes = files.touch, files.bound_bytes

    def read(self, key: int) -> None:
        """See `ReadAhead`."""
        self._files.get(key)


class Prefetch:
    """Reads items into a cache for which there is room beside those that are needed now.

    What is needed now, then what was asked for first, count as used last. All of it fits into the cache, so that only other items are
    evicted.
    """

    def __init__(self, cache: ReadAhead, present: Iterable[Hashable]) -> None:
        """present: keys of the items that are needed now. Those that are not in the cache are left out."""
        self._cache, self._room = cache, cache.max_bytes
        self._counted: set[Hashable] = set()
        for key in present:
            self._count(key, cache.touch(key))

    def read(self, keys: Iterable[Hashable]) -> Steps[None]:
        """Read items until there is no more room. Damaged ones are left out; they are reported when they are shown."""
        for key in keys:
            if key in self._counted:
                continue
            size = self._cache.touch(key)
            if size is None:
                bound = self._cache.bound_bytes(key)
                if bound > self._room:
                    return
                yield Progress(0.0, "Reading ahead")
                try:
                    self._cache.read(key)
                except FarfieldError:
                    continue
                size = self._cache.touch(key)
            self._count(key, size)

    def _count(self, key: Hashable, size: int | None) -> None:
        if size is not None and key not in self._counted:
            self._counted.add(key)
            self._room -= size
