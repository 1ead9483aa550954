"""Patches and texture tiles that are kept in memory as long as there is room, and reading ahead what will be needed soon."""

import struct
from collections.abc import Hashable, Iterable, Sequence

import numpy as np

from ...errors import FarfieldError
from ...files.segment_cache import SegmentCache
from ...imaging.coded_images import RAW_MAGIC, decode
from ...jobs.progress import Progress, Steps
from ..store.patch_codec import Patch
from ..store.patch_outlines import triangulate_outline
from ..store.terrain_store import TerrainStore
from ..textures.grid import TILE_SIZE
from ..textures.store import TextureStore
from ..textures.tile_blocks import CodedTile
from .cut_meshes import PatchMesh, build_outline_mesh, build_patch_mesh

MAX_PATCH_BYTES = 48 << 20  # more than what a cut of a million triangles needs
MAX_TEXTURE_BYTES = 32 << 20
VERTEX_BYTES, TRIANGLE_BYTES = 48, 12  # size of a `PatchMesh` per vertex and per triangle, at most
PREFETCH_ITEMS = 8  # are read at once between two steps
TARGA_HEADER = struct.Struct("<BBBHHBHHHHBB")
TARGA_TRUE_COLOR = 2

PatchKey = tuple[int, int, bool]  # level, row, and whether only the outline is shown


class PatchCache(SegmentCache):
    """Reads patches and keeps those used last. Threads may share it."""

    def __init__(self, store: TerrainStore, max_bytes: int = MAX_PATCH_BYTES) -> None:
        super().__init__(max_bytes)
        self._store = store

    def read(self, key: PatchKey) -> PatchMesh:
        """Return the mesh of a patch, or of its outline.

        Raises:
            FileError: the patch is damaged.
        """
        (mesh,) = self.read_all([key])
        if isinstance(mesh, FarfieldError):
            raise mesh
        return mesh

    def read_all(self, keys: Sequence[PatchKey]) -> list[PatchMesh | FarfieldError]:
        """Return the meshes of several patches; those of damaged ones are errors."""
        return self.get_all(keys, self._create)

    def bound_bytes(self, key: PatchKey) -> int:
        """Return at least the bytes of a patch that has not been read."""
        level, row, is_outline = key
        vertices, triangles, outline_triangles = self._store.levels[level].counts[row].tolist()
        if is_outline and outline_triangles < triangles:
            vertices, triangles = outline_triangles + 2, outline_triangles
        return VERTEX_BYTES * vertices + TRIANGLE_BYTES * triangles

    def _create(self, keys: list[PatchKey]) -> list[PatchMesh | FarfieldError]:
        patches = self._store.read_all([key[:2] for key in keys])
        return [patch if isinstance(patch, FarfieldError) else self._build(patch, *key) for key, patch in zip(keys, patches, strict=True)]

    def _build(self, patch: Patch, level: int, row: int, is_outline: bool) -> PatchMesh:
        outline = triangulate_outline(patch, self._store.corners_of(level, row)) if is_outline else None
        return build_patch_mesh(self._store, patch) if outline is None else build_outline_mesh(self._store, patch, outline)


class TextureFiles(SegmentCache):
    """Reads texture tiles as image files, and keeps those used last."""

    def __init__(self, textures: TextureStore, max_bytes: int = MAX_TEXTURE_BYTES) -> None:
        super().__init__(max_bytes)
        self._textures = textures

    def read(self, key: int) -> CodedTile:
        """Return the image files of a texture tile by its number.

        Raises:
            FileError, ImageError: it is damaged.
        """
        return self.get(key, lambda: to_image_files(self._textures.read_coded(key)))

    def read_all(self, keys: Sequence[int]) -> list[CodedTile | FarfieldError]:
        """Return the image files of several texture tiles; those of damaged ones are errors."""
        tiles: list[CodedTile | FarfieldError] = []
        for key in keys:
            try:
                tiles.append(self.read(key))
            except FarfieldError as error:
                tiles.append(error)
        return tiles

    def bound_bytes(self, key: int) -> int:
        """Return at least the bytes of a tile that has not been read."""
        return int(self._textures.sizes[key]) + TARGA_HEADER.size + 4 * TILE_SIZE**2


def to_image_files(tile: CodedTile) -> CodedTile:
    """Return a tile whose color image every program reads: raw pixels become an uncompressed Targa file, other images stay as stored.

    Raises:
        ImageError: the raw pixels are damaged.
    """
    if not tile.color.startswith(RAW_MAGIC):
        return tile
    return CodedTile(encode_targa(decode(tile.color, TILE_SIZE**2)), tile.alpha)


def encode_targa(pixels: np.ndarray) -> bytes:
    """Return `pixels` (H, W, 3 or 4) uint8, row 0 at the bottom, straight alpha, as an uncompressed Targa file."""
    height, width, channels = pixels.shape
    header = TARGA_HEADER.pack(0, 0, TARGA_TRUE_COLOR, 0, 0, 0, 0, 0, width, height, 8 * channels, 8 if channels == 4 else 0)
    return header + np.ascontiguousarray(pixels[..., [2, 1, 0, 3][:channels]]).tobytes()


class Prefetch:
    """Reads items into a cache as long as there is room in addition to those that are needed now.

    What is needed now, then what was asked for first, count as used last. All of it fits into the cache, so that only other items are
    evicted.
    """

    def __init__(self, cache: PatchCache | TextureFiles, present: Iterable[Hashable]) -> None:
        """present: keys of the items that are needed now. Those that are not in the cache are left out."""
        self._cache, self._room = cache, cache.max_bytes
        self._counted: set[Hashable] = set()
        for key in present:
            self._count(key)

    def read(self, keys: Iterable[Hashable]) -> Steps[None]:
        """Read items until there is no more room. Damaged ones are left out; they are reported when they are shown."""
        unread, needed = [], 0
        for key in keys:
            if key in self._counted:
                continue
            if self._cache.touch(key) is not None:
                self._count(key)
                continue
            needed += self._cache.bound_bytes(key)
            if needed > self._room:
                break
            unread.append(key)
            if len(unread) == PREFETCH_ITEMS:
                yield Progress(0.0, "Reading ahead")
                self._read(unread)
                unread, needed = [], 0
        if unread:
            yield Progress(0.0, "Reading ahead")
            self._read(unread)

    def _read(self, keys: list[Hashable]) -> None:
        self._cache.read_all(keys)
        for key in keys:
            self._count(key)

    def _count(self, key: Hashable) -> None:
        size = self._cache.touch(key)
        if size is not None and key not in self._counted:
            self._counted.add(key)
            self._room -= size
