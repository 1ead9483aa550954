"""Slopes and bends of triangles put together for the vertices that may move."""

import numpy as np
from scipy import sparse


class Assembly:
    """N unknowns: x and y in turn of each of the vertices `moved` (V,) bool. The pattern by which `triangles` (T, 3) join them is worked
    out once."""

    def __init__(self, triangles: np.ndarray, moved: np.ndarray) -> None:
        self.size = 2 * int(moved.sum())
        self._moved = moved
        self._number = np.where(moved, np.cumsum(moved) - 1, -1)
        unknowns = self.unknowns(triangles)
        self._corners = np.flatnonzero(unknowns.ravel() >= 0)
        self._own = unknowns.ravel()[self._corners]
        self._entries, self._place, self._rows, self._starts = _pattern(self._number[triangles], self.size // 2)

    def unknowns(self, vertices: np.ndarray) -> np.ndarray:
        """The unknowns (E, 6) of `vertices` (E, 3), -1 for those that do not move."""
        number = self._number[vertices][:, :, None]
        return np.where(number >= 0, 2 * number + np.arange(2), -1).reshape(-1, 6)

    def slope(self, of_triangles: np.ndarray) -> np.ndarray:
        """Slope (N,) by all unknowns from those (T, 6) of triangles."""
        return np.bincount(self._own, of_triangles.ravel()[self._corners], self.size)

    def bend(self, of_triangles: np.ndarray) -> sparse.csc_array:
        """Bend (N, N) from those (T, 6, 6) of triangles."""
        values = np.bincount(self._place, of_triangles.ravel()[self._entries], len(self._rows))
        return sparse.csc_array((values, self._rows, self._starts), shape=(self.size, self.size))

    def move(self, unknowns: np.ndarray) -> np.ndarray:
        """Moves (V, 2) of all vertices from the `unknowns` (N,)."""
        made = np.zeros((len(self._moved), 2))
        made[self._moved] = unknowns.reshape(-1, 2)
        return made


def _pattern(numbers: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where in a matrix of 2 by 2 blocks the bends (T, 6, 6) of triangles go, whose corners are `numbers` (T, 3) of `count` blocks, -1 for
    none: entries (E,) of the bends that count, the places (E,) of their sums, and of these the rows, and the starts of columns (CSC)."""
    columns, rows = np.broadcast_to(numbers[:, None], (len(numbers), 3, 3)), np.broadcast_to(numbers[:, :, None], (len(numbers), 3, 3))
    there = (columns >= 0) & (rows >= 0)
    keys, block = np.unique(columns[there].astype(np.int64) * count + rows[there], return_inverse=True)
    column, row = np.divmod(keys, max(count, 1))
    before = np.searchsorted(column, np.arange(count + 1))
    tall = np.diff(before)
    down, across = np.meshgrid(np.arange(2), np.arange(2), indexing="ij")
    inside = np.arange(len(keys)) - before[column]
    places = (4 * before[column] + 2 * inside)[:, None, None] + down + across * (2 * tall[column])[:, None, None]
    triangle, corner, other = np.nonzero(there)
    entries = (36 * triangle + 12 * corner + 2 * other)[:, None, None] + 6 * down + across
    indices = np.empty(4 * len(keys), np.int32)
    indices[places] = 2 * row[:, None, None] + down
    starts = np.append(np.stack([4 * before[:-1], 4 * before[:-1] + 2 * tall], axis=1).ravel(), 4 * len(keys)).astype(np.int32)
    return entries.ravel(), places[block].ravel(), indices, starts


def assembled(unknowns: np.ndarray, parts: np.ndarray, size: int) -> np.ndarray | sparse.csc_array:
    """Slopes (E, 6) to one (size,), or bends (E, 6, 6) to one (size, size), by the `unknowns` (E, 6) of every element."""
    if parts.ndim == 2:
        there = unknowns >= 0
        return np.bincount(unknowns[there], parts[there], size)
    rows, columns = np.broadcast_to(unknowns[:, :, None], parts.shape), np.broadcast_to(unknowns[:, None, :], parts.shape)
    there = (rows >= 0) & (columns >= 0)
    return sparse.coo_array((parts[there], (rows[there], columns[there])), shape=(size, size)).tocsc()
