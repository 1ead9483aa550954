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
        rows, columns = np.repeat(unknowns, 6, axis=1).ravel(), np.tile(unknowns, (1, 6)).ravel()
        self._entries = np.flatnonzero((rows >= 0) & (columns >= 0))
        keys, self._place = np.unique(columns[self._entries].astype(np.int64) * self.size + rows[self._entries], return_inverse=True)
        self._rows = (keys % self.size).astype(np.int32)
        self._starts = np.searchsorted(keys, np.arange(self.size + 1, dtype=np.int64) * self.size).astype(np.int32)

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


def assembled(unknowns: np.ndarray, parts: np.ndarray, size: int) -> np.ndarray | sparse.csc_array:
    """Slopes (E, 6) to one (size,), or bends (E, 6, 6) to one (size, size), by the `unknowns` (E, 6) of every element."""
    if parts.ndim == 2:
        there = unknowns >= 0
        return np.bincount(unknowns[there], parts[there], size)
    rows, columns = np.broadcast_to(unknowns[:, :, None], parts.shape), np.broadcast_to(unknowns[:, None, :], parts.shape)
    there = (rows >= 0) & (columns >= 0)
    return sparse.coo_array((parts[there], (rows[there], columns[there])), shape=(size, size)).tocsc()
