"""Tiles of a cut: squares of the quadtree whose patches are shown as one mesh.

A tile lies within one texture tile, or has no texture. Squares with many triangles are split further, so that little has to be filled again
when some patches change.
"""

import heapq
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from ...arrays import to_starts
from ...errors import FileError
from ..store.terrain_store import TerrainStore
from ..textures.grid import BORDER, STEP, TILE_SIZE
from ..textures.tile_index import morton_keys
from .caches import PatchCache, PatchKey
from .cut_meshes import merge_patches, remove_unused
from .extraction import Cut

MAX_TILES = 64
MAX_TILE_TRIANGLES = 6000  # larger tiles are split
KEPT_SPLIT = 2.0  # factor of the triangles of squares that were split before, so that few tiles change
LATTICE = 2.0**-14  # cells between two positions that vertices can have, so that tiles meet exactly in single precision

TileKey = tuple[int, int, int]  # level of the quadtree, i along x, j along y


@dataclass(frozen=True)
class Tile:
    """Which patches a tile shows, and its texture.

    Attributes:
        levels, rows: (N,) int64, patches in the order of the bintrees.
        is_outline: (N,) bool, see `Cut`.
        texture: number of the square of its maps, see `tile_maps`, None without.
        square: that square.
    """

    levels: np.ndarray
    rows: np.ndarray
    is_outline: np.ndarray
    texture: int | None
    square: TileKey

    @property
    def signature(self) -> tuple[bytes, bytes, bytes, int | None]:
        """What is different if the tile must be filled again."""
        return self.levels.tobytes(), self.rows.tobytes(), self.is_outline.tobytes(), self.texture

    def list_patches(self) -> list[PatchKey]:
        """Return the level and row of each patch, and whether its outline is shown."""
        return list(zip(self.levels.tolist(), self.rows.tolist(), self.is_outline.tolist(), strict=True))


@dataclass(frozen=True)
class TileMesh:
    """The mesh of a tile, without holes.

    Attributes:
        location: (3,) float64, position of the mesh in local meters with exaggeration.
        vertices: (V, 3) float32, relative to the location.
        normals: (V, 3) float32, unit vectors.
        triangles: (T, 3) int32, counterclockwise seen from above.
        uvs: (V, 2) float32 in the texture tile, None without texture.
        levels: (T,) int8, levels of the patches.
        ids: (V,) int64, see `PatchMesh`.
        damages: sentences about patches that cannot be read and are missing in the mesh.
    """

    location: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    uvs: np.ndarray | None
    levels: np.ndarray
    ids: np.ndarray
    damages: tuple[str, ...] = ()


class TileGrouping:
    """Groups the patches of cuts into tiles. It remembers the last grouping, so that the next one differs little."""

    def __init__(self, store: TerrainStore) -> None:
        self._store = store
        self._split: set[TileKey] = set()

    def group(self, cut: Cut, textures: dict[TileKey, int | None]) -> dict[TileKey, Tile]:
        """Return the tiles of a cut by their squares: within the squares of `textures`, which cover the terrain, at most MAX_TILES."""
        depth = self._store.tree.depth
        squares = np.empty((len(cut), 2), np.int64)
        for level in np.unique(cut.levels).tolist():
            is_level = cut.levels == level
            squares[is_level] = self._store.leaf_squares[level][cut.rows[is_level]]
        counts = cut.count_triangles(self._store)
        codes = morton_keys(squares)
        order = np.lexsort((cut.rows, cut.levels, codes))
        ordered, sums = codes[order].tolist(), to_starts(counts[order]).tolist()
        heap: list[tuple[float, TileKey, int, slice, TileKey]] = []

        def add(key: TileKey, code: int, source: TileKey) -> None:
            ends = (bisect_left(ordered, number << 2 * (depth - key[0])) for number in (code, code + 1))
            part = slice(*ends)
            if part.stop > part.start:
                weight = float(sums[part.stop] - sums[part.start]) * (KEPT_SPLIT if key in self._split else 1.0)
                heapq.heappush(heap, (-weight, key, code, part, source))

        for key, code in zip(textures, morton_keys(np.array([key[1:] for key in textures])).tolist(), strict=True):
            add(key, code, key)
        split, final = set(), []
        while heap:
            weight, key, code, part, source = heapq.heappop(heap)
            is_large = -weight > MAX_TILE_TRIANGLES and key[0] < depth and part.stop - part.start > 1
            if is_large and len(heap) + len(final) + 4 <= MAX_TILES:
                split.add(key)
                for number, child in enumerate(_children(key)):
                    add(child, 4 * code + number, source)
            else:
                final.append((key, part, source))
        self._split = split
        levels, rows, is_outline = cut.levels[order], cut.rows[order], cut.is_outline[order]
        return {key: Tile(levels[part], rows[part], is_outline[part], textures[source], source) for key, part, source in final}


def build_tile_mesh(store: TerrainStore, cache: PatchCache, key: TileKey, tile: Tile, exaggeration: float) -> TileMesh:
    """Return the mesh of a tile, without patches that are damaged."""
    meshes = cache.read_all(tile.list_patches())
    is_intact = np.array([not isinstance(mesh, FileError) for mesh in meshes])
    damages = tuple(str(mesh) for mesh in meshes if isinstance(mesh, FileError))
    patches, levels = [mesh for mesh in meshes if not isinstance(mesh, FileError)], tile.levels[is_intact]
    location = locate_tile(store, key)
    if not patches:
        no_vertices, no_triangles = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)
        return TileMesh(location, no_vertices, no_vertices, no_triangles, None, np.zeros(0, np.int8), np.zeros(0, np.int64), damages)
    mesh = remove_unused(merge_patches(patches, levels))
    step = _lattice_step(store) * LATTICE
    vertices = np.rint(mesh.positions * [1.0, 1.0, exaggeration] / step) * step - location
    normals = mesh.normals * np.array([1.0, 1.0, 1.0 / exaggeration], np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uvs = None if tile.texture is None else texture_uvs(store, mesh.ids, tile.square)
    return TileMesh(location, vertices.astype(np.float32), normals, mesh.triangles, uvs, mesh.levels, mesh.ids, damages)


def locate_tile(store: TerrainStore, key: TileKey) -> np.ndarray:
    """Return the position (3,) float64 in local meters that the vertices of a tile are relative to: near its center, at height 0, exact in
    single precision."""
    side = store.tree.side / (1 << key[0])
    x, y = ((number + 0.5) * side for number in key[1:])
    center = store.frame.to_local(np.array(min(x, store.header.columns)), np.array(min(y, store.header.rows)))
    step = _lattice_step(store)
    return np.array([*(np.rint(float(value) / step) * step for value in center), 0.0])


def _lattice_step(store: TerrainStore) -> float:
    """Return the largest power of two, in meters, that is not larger than a cell."""
    return float(2.0 ** np.floor(np.log2(store.header.cell_size)))


def texture_uvs(store: TerrainStore, ids: np.ndarray, square: TileKey) -> np.ndarray:
    """Return the UV coordinates (V, 2) float32 of vertices, given by their `ids` (V,), in the texture tile of a square; see
    `textures.grid`."""
    grid = np.stack([ids % store.header.columns, ids // store.header.columns], axis=1)
    level, *position = square
    return ((BORDER + STEP * (grid * (2.0**level / store.tree.side) - position)) / TILE_SIZE).astype(np.float32)


def _children(key: TileKey) -> list[TileKey]:
    """Return the four squares that a square is divided into, in the order of `morton_keys`."""
    level, i, j = key
    return [(level + 1, 2 * i + x, 2 * j + y) for y in (0, 1) for x in (0, 1)]
