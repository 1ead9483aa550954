"""Edges of triangle meshes: adjacent triangles, boundary and interior edges."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .proximity import argsort_pairs, counting_argsort, decode_pairs, encode_pairs


@dataclass(frozen=True)
class Edges:
    """The edges of a triangle mesh.

    ends: (E, 2) int32 vertex indices, the lower one first, in ascending order. face_edges: (T, 3), the edge opposite to each corner of
    every triangle. vertex_count: number of vertices, used or not.
    """

    ends: np.ndarray
    face_edges: np.ndarray
    vertex_count: int

    @cached_property
    def face_counts(self) -> np.ndarray:
        """(E,) number of triangles at each edge: 1 on a boundary, 2 inside a manifold."""
        return np.bincount(self.face_edges.ravel(), minlength=len(self.ends))

    @cached_property
    def boundary_vertices(self) -> np.ndarray:
        """(vertex_count,) bool: which vertices are ends of boundary edges."""
        on_boundary = np.zeros(self.vertex_count, bool)
        on_boundary[self.ends[self.face_counts == 1]] = True
        return on_boundary

    @cached_property
    def keys(self) -> np.ndarray:
        """(E,) int64, one integer per edge, ascending; see `encode_pairs`."""
        return encode_pairs(*self.ends.T, self.vertex_count)

    @cached_property
    def interior(self) -> np.ndarray:
        """(I,) indices of the edges between exactly two triangles, ascending."""
        return np.flatnonzero(self.face_counts == 2)

    @cached_property
    def interior_halfedges(self) -> np.ndarray:
        """(I, 2), the two halfedges of each of `interior`: halfedge 3 t + c is opposite to corner c of triangle t."""
        order = counting_argsort(self.face_edges.ravel(), len(self.ends))
        first = (np.cumsum(self.face_counts) - self.face_counts)[self.interior]
        return np.stack([order[first], order[first + 1]], axis=1)

    def between(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return the index of the edge between each of the vertices `first` and `second`, of any shape; -1 where there is none."""
        keys = encode_pairs(first, second, self.vertex_count)
        indices = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[indices] == keys, indices, -1)


def find_edges(triangles: np.ndarray, vertex_count: int | None = None) -> Edges:
    """Find the edges of `triangles` (T, 3) among `vertex_count` vertices; by default as many as the largest index needs."""
    vertex_count = int(triangles.max(initial=-1)) + 1 if vertex_count is None else vertex_count
    starts, ends = triangles[:, [1, 2, 0]].ravel(), triangles[:, [2, 0, 1]].ravel()
    order = argsort_pairs(starts, ends, vertex_count)
    keys = encode_pairs(starts[order], ends[order], vertex_count)
    is_first = np.ones(len(keys), bool)
    is_first[1:] = keys[1:] != keys[:-1]
    index = np.empty(len(keys), np.int64)
    index[order] = np.cumsum(is_first) - 1
    return Edges(decode_pairs(keys[is_first], vertex_count), index.reshape(-1, 3), vertex_count)


def halfedge_ends(triangles: np.ndarray, halfedges: np.ndarray) -> np.ndarray:
    """Return the values (N, 2) of `triangles` (T, 3) at the start and the end of `halfedges` (N,), 3 t + c, opposite to corner c."""
    faces, corners = halfedges // 3, halfedges % 3
    return np.stack([triangles[faces, (corners + 1) % 3], triangles[faces, (corners + 2) % 3]], axis=1)
