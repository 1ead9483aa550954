"""Lists of tiles of a quadtree, found by level and position, and errors that are nested so that every cut is valid.

A cut refines a tile if its error exceeds a threshold. Let P be a refined tile of level t + 1, N a tile of that level that shares an edge
with it, and Q the parent of N. If error(Q) >= error(P), Q is refined, too. So every tile that shares an edge with a refined tile is in the
cut or refined, and no tile of the cut touches one that is two levels finer along an edge.

Hence the error of a tile is at least those of its four children and of the eight tiles that share an edge with a child. The errors may be
those of a store or what these cover in an image, as long as all tiles of a cut are tested with the same threshold.
"""

from functools import cached_property

import numpy as np

# Positions of the four children of a tile and of the eight tiles that share an edge with a child, from twice the position of the tile.
EDGE_NEIGHBORHOOD = np.array([(i, j) for i in range(-1, 3) for j in range(-1, 3) if i in (0, 1) or j in (0, 1)])


class TileIndex:
    """Tiles of all levels of a quadtree: tile n is the n-th of the arrays.

    Attributes:
        levels: (N,) int32, ascending.
        tiles: (N, 2) int32, columns i (along x) and j (along y).
        level_count: number of levels; the finest may have no tile.
    """

    def __init__(self, levels: np.ndarray, tiles: np.ndarray, level_count: int) -> None:
        self.levels, self.tiles, self.level_count = levels, tiles, level_count
        self._keys = _tile_keys(levels, tiles)
        self._order = np.argsort(self._keys, kind="stable")
        self._sorted = self._keys[self._order]

    def __len__(self) -> int:
        return len(self.levels)

    @property
    def is_valid(self) -> bool:
        """Whether levels ascend, every tile lies in the root square, and no tile exists twice."""
        levels, tiles = self.levels.astype(np.int64), self.tiles
        is_possible = bool(((levels >= 0) & (levels < self.level_count)).all() and (np.diff(levels) >= 0).all())
        if not is_possible or (tiles < 0).any() or (tiles >= (np.int64(1) << levels)[:, None]).any():
            return False
        return bool((np.diff(self._sorted) > 0).all())

    def find(self, levels: np.ndarray | int, tiles: np.ndarray) -> np.ndarray:
        """Return the numbers (M,) int64 of `tiles` (M, 2) at `levels` (M,) or one level, -1 for tiles that do not exist."""
        if not len(self._keys):
            return np.full(len(tiles), -1)
        levels = np.broadcast_to(levels, len(tiles))
        is_possible = ((tiles >= 0) & (tiles < (1 << levels.astype(np.int64))[:, None])).all(axis=1) & (levels >= 0)
        keys = _tile_keys(np.where(is_possible, levels, 0), np.where(is_possible[:, None], tiles, 0))
        places = np.minimum(np.searchsorted(self._sorted, keys), len(self._keys) - 1)
        return np.where(is_possible & (self._sorted[places] == keys), self._order[places], -1)

    def numbers(self, level: int) -> np.ndarray:
        """Return the numbers of the tiles of a level, ascending."""
        return np.arange(*np.searchsorted(self.levels, [level, level + 1]))

    def parents(self) -> np.ndarray:
        """Return the number of the parent of every tile, (N,) int64, -1 for the root and where it does not exist."""
        return self.find(self.levels - 1, self.tiles >> 1)

    @cached_property
    def relatives(self) -> list[np.ndarray]:
        """For the tiles of each level but the finest, the numbers (M, 12) int64 of their four children and of the eight tiles that share an
        edge with a child; -1 where one does not exist."""
        around = [2 * self.tiles[self.numbers(level)][:, None, :] + EDGE_NEIGHBORHOOD for level in range(self.level_count - 1)]
        return [self.find(level + 1, tiles.reshape(-1, 2)).reshape(tiles.shape[:2]) for level, tiles in enumerate(around)]

    def nest(self, errors: np.ndarray) -> np.ndarray:
        """Return the errors (N,) of the tiles raised to the largest of the `errors` (N,) of the tiles that their refinement depends on."""
        errors = errors.copy()
        for level in range(self.level_count - 2, -1, -1):
            numbers, relatives = self.numbers(level), self.relatives[level]
            if relatives.size:
                below = np.where(relatives >= 0, errors[relatives], 0.0).max(axis=1)
                errors[numbers] = np.maximum(errors[numbers], below)
        return errors

    def select_cut(self, is_refined: np.ndarray) -> np.ndarray:
        """Return the numbers of the tiles of the cut: those below refined ancestors that are not refined, (N,) bool, or of the finest
        level.

        Where children of a refined tile do not exist, nothing is known, and the cut has no tile there.
        """
        parents = self.parents()
        is_open = np.zeros(len(self), bool)
        is_visited = parents < 0
        for level in range(self.level_count):
            numbers = self.numbers(level)
            if level:
                is_visited[numbers] = is_open[parents[numbers]] & (parents[numbers] >= 0)
            is_open[numbers] = is_visited[numbers] & is_refined[numbers] & (level < self.level_count - 1)
        return np.flatnonzero(is_visited & ~is_open)


def _tile_keys(levels: np.ndarray, tiles: np.ndarray) -> np.ndarray:
    """Return a number for every tile of every level, (N,) int64: level and position have 20 bits each, and more for the level."""
    tiles = tiles.astype(np.int64)
    return (levels.astype(np.int64) << 40) | (tiles[:, 1] << 20) | tiles[:, 0]


def morton_keys(tiles: np.ndarray) -> np.ndarray:
    """Return the bits of i and j of `tiles` (N, 2), interleaved, (N,) int64: tiles within a coarser one have consecutive keys."""
    bits = tiles.astype(np.int64)
    for shift, mask in (
        (16, 0x0000FFFF0000FFFF),
        (8, 0x00FF00FF00FF00FF),
        (4, 0x0F0F0F0F0F0F0F0F),
        (2, 0x3333333333333333),
        (1, 0x5555555555555555),
    ):
        bits = (bits | (bits << shift)) & mask
    return bits[:, 0] | (bits[:, 1] << 1)
