"""Assembles the gradients and Hessians of elements into those of all vertices that may move."""

import numpy as np
from scipy import sparse


class Assembly:
    """N degrees of freedom (DOFs): x and y in turn of the vertices `is_free` (V,) bool.

    The sparsity pattern of `triangles` (T, 3) is computed once. DOFs of an element are x and y of its three vertices in turn.
    """

    def __init__(self, triangles: np.ndarray, is_free: np.ndarray) -> None:
        self.size = 2 * int(is_free.sum())
        self._is_free = is_free
        self._index = np.where(is_free, np.cumsum(is_free) - 1, -1)
        dofs = self.dof_indices(triangles)
        self._free_entries = np.flatnonzero(dofs.ravel() >= 0)
        self._free_dofs = dofs.ravel()[self._free_entries]
        self._entries, self._positions, self._rows, self._column_starts = _sparsity_pattern(self._index[triangles], self.size // 2)

    def dof_indices(self, vertices: np.ndarray) -> np.ndarray:
        """Return the DOFs (E, 6) of elements with `vertices` (E, 3), -1 for fixed vertices."""
        index = self._index[vertices][:, :, None]
        return np.where(index >= 0, 2 * index + np.arange(2), -1).reshape(-1, 6)

    def gradient(self, gradients: np.ndarray) -> np.ndarray:
        """Return the gradient (N,) from those (T, 6) of the triangles."""
        return np.bincount(self._free_dofs, gradients.ravel()[self._free_entries], self.size)

    def hessian(self, hessians: np.ndarray) -> sparse.csc_array:
        """Return the Hessian (N, N) from those (T, 6, 6) of the triangles."""
        values = np.bincount(self._positions, hessians.ravel()[self._entries], len(self._rows))
        return sparse.csc_array((values, self._rows, self._column_starts), shape=(self.size, self.size))

    def displacement(self, direction: np.ndarray) -> np.ndarray:
        """Return the displacement (V, 2) of all vertices from a `direction` (N,); 0 for fixed vertices."""
        displacement = np.zeros((len(self._is_free), 2))
        displacement[self._is_free] = direction.reshape(-1, 2)
        return displacement


def _sparsity_pattern(blocks: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the sparsity pattern (CSC) of a matrix of 2 by 2 blocks.

    Args:
        blocks: (T, 3) block index of each corner of the triangles, -1 for fixed ones.
        count: number of blocks per side.

    Returns:
        indices (E,) of the used entries of the Hessians (T, 6, 6); positions (E,) of their sums in the data array; row indices of the data
        array; column starts.
    """
    columns, rows = np.broadcast_to(blocks[:, None], (len(blocks), 3, 3)), np.broadcast_to(blocks[:, :, None], (len(blocks), 3, 3))
    is_used = (columns >= 0) & (rows >= 0)
    keys, block = np.unique(columns[is_used].astype(np.int64) * count + rows[is_used], return_inverse=True)
    column, row = np.divmod(keys, max(count, 1))
    block_starts = np.searchsorted(column, np.arange(count + 1))
    heights = np.diff(block_starts)  # blocks per column
    down, across = np.meshgrid(np.arange(2), np.arange(2), indexing="ij")
    index_in_column = np.arange(len(keys)) - block_starts[column]
    positions = (4 * block_starts[column] + 2 * index_in_column)[:, None, None] + down + across * (2 * heights[column])[:, None, None]
    triangle, corner, other_corner = np.nonzero(is_used)
    entries = (36 * triangle + 12 * corner + 2 * other_corner)[:, None, None] + 6 * down + across
    row_indices = np.empty(4 * len(keys), np.int32)
    row_indices[positions] = 2 * row[:, None, None] + down
    column_starts = np.stack([4 * block_starts[:-1], 4 * block_starts[:-1] + 2 * heights], axis=1).ravel()
    column_starts = np.append(column_starts, 4 * len(keys)).astype(np.int32)
    return entries.ravel(), positions[block].ravel(), row_indices, column_starts


def assemble(dofs: np.ndarray, values: np.ndarray, size: int) -> np.ndarray | sparse.csc_array:
    """Sum gradients (E, 6) to (size,), or Hessians (E, 6, 6) to (size, size), by the `dofs` (E, 6) of every element; -1 if fixed."""
    if values.ndim == 2:
        is_free = dofs >= 0
        return np.bincount(dofs[is_free], values[is_free], size)
    rows, columns = np.broadcast_to(dofs[:, :, None], values.shape), np.broadcast_to(dofs[:, None, :], values.shape)
    is_free = (rows >= 0) & (columns >= 0)
    return sparse.coo_array((values[is_free], (rows[is_free], columns[is_free])), shape=(size, size)).tocsc()
