"""Edges of triangle meshes: which triangles meet at each, where the border is."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .spatial import keys_of, split_keys


@dataclass(frozen=True)
class Edges:
    """The edges of a mesh.

    ends (E, 2) int32, lower vertex first, in rising order. opposite (T, 3): the edge opposite to each corner of every triangle.
    count: of vertices, used or not.
    """

    ends: np.ndarray
    opposite: np.ndarray
    count: int

    @cached_property
    def uses(self) -> np.ndarray:
        """How many triangles have each edge (E,): 1 along a border, 2 within a manifold."""
        return np.bincount(self.opposite.ravel(), minlength=len(self.ends))

    @cached_property
    def on_border(self) -> np.ndarray:
        """(count,) bool: which vertices are at the end of an edge of one triangle only."""
        border = np.zeros(self.count, bool)
        border[self.ends[self.uses == 1]] = True
        return border

    @cached_property
    def keys(self) -> np.ndarray:
        """One number (E,) int64 an edge, rising."""
        return keys_of(*self.ends.T, self.count)

    @cached_property
    def inner(self) -> np.ndarray:
        """The edges (I,) between just two triangles, in rising order."""
        return np.flatnonzero(self.uses == 2)

    @cached_property
    def inner_sides(self) -> np.ndarray:
        """The two sides (I, 2) of each of `inner`: side 3 t + c lies opposite to corner c of triangle t."""
        order = np.argsort(self.opposite.ravel(), kind="stable")
        first = (np.cumsum(self.uses) - self.uses)[self.inner]
        return np.stack([order[first], order[first + 1]], axis=1)

    def between(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The edge between each of the vertices `first` and `second`, of any shape; -1 where there is none."""
        wanted = keys_of(first, second, self.count)
        found = np.minimum(np.searchsorted(self.keys, wanted), len(self.keys) - 1)
        return np.where(self.keys[found] == wanted, found, -1)


def edges_of(triangles: np.ndarray, count: int | None = None) -> Edges:
    """The edges of `triangles` (T, 3) among `count` vertices; by default as many as there are numbers."""
    count = int(triangles.max(initial=-1)) + 1 if count is None else count
    starts, ends = triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]
    different, index = np.unique(keys_of(starts, ends, count), return_inverse=True)
    return Edges(split_keys(different, count), index.reshape(-1, 3), count)
