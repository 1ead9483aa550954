"""Incident triangles of vertices, in arrays whose last axis runs over vertices.

NumPy loops over the last axis, so arrays of shape (degree, vertices) are several times as fast as (vertices, degree). Vertices are
therefore processed in groups of equal degree. Triangles are stored as (3, T) for the same reason.

Arrays that index others are intp, because NumPy converts all others whenever it uses them, which takes half as long as the use itself.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..arrays import gather

MAX_DEGREE = 20  # vertices with more incident triangles are not removed
ALIGNMENT = 16  # vertices of a group, so that rows of float32 begin at multiples of 64 bytes


@dataclass(frozen=True)
class VertexRings:
    """The triangles around each vertex of a mesh of T triangles.

    starts: (V + 1,) intp, into `corners`. corners: (3 T,) intp, the corners (T * row + triangle) of every vertex in ascending order.
    next, previous: (3 T,) intp, the vertex after and before each corner in its counterclockwise triangle.
    """

    starts: np.ndarray
    corners: np.ndarray
    next: np.ndarray
    previous: np.ndarray

    def group_by_degree(self, vertices: np.ndarray, max_entries: int, power: int = 1) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield positions in `vertices` (N,) and the corners (degree, positions) of these vertices, for vertices of equal degree.

        Vertices without triangles or with more than MAX_DEGREE are left out. Groups have about `max_entries` / degree**power vertices, so
        that the arrays that are made from them stay in the CPU cache.
        """
        starts = gather(self.starts, vertices)
        degrees = (gather(self.starts, vertices + 1) - starts).astype(np.int32)
        for degree in range(1, min(MAX_DEGREE, int(degrees.max(initial=0))) + 1):
            members = np.flatnonzero(degrees == degree)
            size = max(max_entries // degree**power // ALIGNMENT, 1) * ALIGNMENT
            for first in range(0, len(members), size):
                positions = members[first : first + size]
                yield positions, gather(self.corners, gather(starts, positions) + np.arange(degree)[:, None])


def build_rings(triangles: np.ndarray, vertex_count: int) -> VertexRings:
    """Return the rings of the counterclockwise `triangles` (3, T) intp."""
    count = triangles.size
    rows = np.arange(count + 1, dtype=np.int32)
    vertices = triangles.reshape(-1).astype(np.int32)
    by_corner = sparse.csr_matrix((rows[:-1].astype(np.intp), vertices, rows), shape=(count, vertex_count))
    by_vertex = by_corner.tocsc()  # a counting sort
    return VertexRings(by_vertex.indptr.astype(np.intp), by_vertex.data, triangles[[1, 2, 0]].reshape(-1), triangles[[2, 0, 1]].reshape(-1))


def to_triangles(corners: np.ndarray, triangle_count: int) -> np.ndarray:
    """Return the triangles of corners (N,) intp, see `VertexRings`."""
    return corners - corners // triangle_count * triangle_count  # several times as fast as the remainder
