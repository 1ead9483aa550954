"""The total energy of a UV map: stretch, and optionally barriers for the shape of triangles and for the boundary.

The gradients and Hessians of elements are assembled into those of all vertices that may move.
"""

from collections.abc import Callable

import numpy as np
from scipy import sparse

from .boundary_barrier import BoundaryBarrier
from .shape_barrier import ShapeBarrier
from .stretch_energy import StretchEnergy


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


class UvEnergy:
    """Energy of uv (V, 2), which are never changed in place. The N degrees of freedom are the coordinates of the free vertices.

    assembly: of the triangles of `stretch`. boundary: None where the boundary is fixed. relax_worst_vertices: returns uv with fewer
    strongly distorted triangles, which would limit the next step; the same array where there are none.
    """

    def __init__(
        self,
        assembly: Assembly,
        stretch: StretchEnergy,
        shapes: list[ShapeBarrier],
        boundary: BoundaryBarrier | None,
        relax_worst_vertices: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self._assembly, self._stretch, self._shapes, self._boundary = assembly, stretch, shapes, boundary
        self.relax_worst_vertices = relax_worst_vertices

    def value(self, uv: np.ndarray) -> float:
        """Return the energy; infinite where triangles are flipped or too thin, or where the boundary intersects itself."""
        total = self._stretch.value(uv)
        for barrier in (*self._shapes, self._boundary):
            if barrier is not None and np.isfinite(total):
                total += barrier.value(uv)
        return total

    def lower_bound(self) -> float:
        """Return a lower bound of the energy of all uv."""
        return self._stretch.lower_bound()

    def max_step(self, uv: np.ndarray, displacement: np.ndarray) -> float:
        """Return the multiple of `displacement` (V, 2) at which a triangle has no area left, or the boundary touches itself."""
        max_step = self._stretch.max_step(uv, displacement)
        return max_step if self._boundary is None else min(max_step, self._boundary.max_step(uv, displacement))

    def gradient(self, uv: np.ndarray) -> np.ndarray:
        """Return the gradient (N,)."""
        by_triangle = self._stretch.gradients(uv)
        for shape in self._shapes:
            np.add.at(by_triangle, *shape.gradients(uv))
        gradient = self._assembly.gradient(by_triangle)
        if self._boundary is not None:
            vertices, gradients = self._boundary.gradients(uv)
            gradient += assemble(self._assembly.dof_indices(vertices), gradients, self._assembly.size)
        return gradient

    def hessian(self, uv: np.ndarray) -> sparse.csc_array:
        """Return the Hessian (N, N), positive semidefinite."""
        by_triangle = self._stretch.hessians(uv)
        for shape in self._shapes:
            np.add.at(by_triangle, *shape.hessians(uv))
        hessian = self._assembly.hessian(by_triangle)
        if self._boundary is not None:
            vertices, hessians = self._boundary.hessians(uv)
            hessian = hessian + assemble(self._assembly.dof_indices(vertices), hessians, self._assembly.size)
        return hessian

    def displacement(self, direction: np.ndarray) -> np.ndarray:
        """Return the displacement (V, 2) of all vertices from a `direction` (N,)."""
        return self._assembly.displacement(direction)


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
    heights = np.diff(block_starts)  # Blocks per column.
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
