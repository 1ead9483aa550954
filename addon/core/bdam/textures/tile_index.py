"""Lists of tiles of a quadtree, found by level and position."""

import numpy as np

EDGE_NEIGHBORHOOD = np.array([(i, j) for i in range(-1, 3) for j in range(-1, 3) if i in (0, 1) or j in (0, 1)])  # see `relatives`


def order_along_curve(tiles: np.ndarray) -> np.ndarray:
    """Return the order (N,) int64 of `tiles` (N, 2), columns i and j, along Morton's curve: near tiles are near in files."""
    return np.argsort(morton_keys(tiles), kind="stable")


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

    def relatives(self, level: int) -> np.ndarray:
        """Return for the tiles of a level the numbers (M, 12) int64 of their four children and the eight tiles that share an edge with a
        child; -1 where one does not exist."""
        tiles = self.tiles[self.numbers(level)]
        around = 2 * tiles[:, None, :] + EDGE_NEIGHBORHOOD
        return self.find(level + 1, around.reshape(-1, 2)).reshape(len(tiles), len(EDGE_NEIGHBORHOOD))


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
