"""In which squares of the quadtree patches lie, and how high the terrain is there.

Level s of the quadtree has squares (i, j), i along x and j along y, whose side is that of the root square divided by 2**s. A patch of level
2 s or 2 s + 1 lies within one square of level s, and a patch of level 2 s is one half of it.
"""

import numpy as np

from ..store.terrain_store import TerrainStore
from ..tree import bisect


def find_leaf_squares(store: TerrainStore) -> list[np.ndarray]:
    """Return for each level the squares (N, 2) int32 of the quadtree's finest level that contain the centroids of its patches.

    The square of level s with the centroid follows from it: `squares >> (depth - s)`.
    """
    tree = store.tree
    corners = tree.triangle_corners(0, store.levels[0].indices).astype(np.int32)  # half of the memory
    squares = [leaf_squares_of(corners, tree.leaf_cells)]
    for level in range(1, len(store.levels)):
        indices = store.levels[level].indices
        parents = np.searchsorted(store.levels[level - 1].indices, indices >> 1)
        corners = bisect(corners[parents], (indices & 1).astype(bool))
        squares.append(leaf_squares_of(corners, tree.leaf_cells))
    return squares


def square_boxes(store: TerrainStore, leaf_squares: list[np.ndarray], level: int, squares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounding boxes, low and high (M, 3) float64 in local meters, of the terrain in `squares` (M, 2) of a level of the
    quadtree; low is infinite and high minus infinity where there is no terrain.

    leaf_squares: see `find_leaf_squares`.
    """
    patches = store.levels[2 * level]
    keys = _keys(leaf_squares[2 * level] >> (store.tree.depth - level))
    wanted = _keys(squares)
    order = np.argsort(wanted, kind="stable")
    places = np.searchsorted(wanted[order], keys)
    is_wanted = places < len(wanted)
    is_wanted[is_wanted] = wanted[order][places[is_wanted]] == keys[is_wanted]
    targets = order[places[is_wanted]]
    low, high = np.full((len(squares), 3), np.inf), np.full((len(squares), 3), -np.inf)
    np.minimum.at(low, targets, patches.low[is_wanted])
    np.maximum.at(high, targets, patches.high[is_wanted])
    return low, high


def contains_squares(squares: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which of `squares` (N, 2) int are among `others` (M, 2), (N,) bool."""
    return np.isin(_keys(squares), _keys(others))


def leaf_squares_of(corners: np.ndarray, leaf_cells: int) -> np.ndarray:
    """Return the squares (N, 2) of triangles with `corners` (N, 3, 2) in cells."""
    return (corners.sum(axis=1, dtype=corners.dtype) // (3 * leaf_cells)).astype(np.int32, copy=False)


def _keys(squares: np.ndarray) -> np.ndarray:
    """Return a number (N,) int64 for each square of one level."""
    return (squares[:, 1].astype(np.int64) << 32) | squares[:, 0]
