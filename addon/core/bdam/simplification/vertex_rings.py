"""Incident triangles of vertices, in arrays whose last axis runs over vertices.

NumPy loops over the last axis, so arrays of shape (degree, vertices) are several times as fast as (vertices, degree). Vertices are therefore
processed in groups of equal degree.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

MAX_DEGREE = 12  # vertices with more incident triangles are not removed
CHUNK_ENTRIES = 1 << 15  # entries of a (degree, vertices) array that are processed at once, so that they stay in the CPU cache


@dataclass(frozen=True)
class VertexRings:
    """The triangles around each vertex of a mesh.

    starts: (V + 1,) int32, into `corners`. corners: (3 T,) int32, the corners (3 * triangle + corner) of every vertex in ascending order.
    next, previous: (3 T,) int32, the vertex after and before each corner in its counterclockwise triangle.
    """

    starts: np.ndarray
    corners: np.ndarray
    next: np.ndarray
    previous: np.ndarray

    @property
    def degrees(self) -> np.ndarray:
        """The number of incident triangles of each vertex, (V,) int32."""
        return np.diff(self.starts)

    def group_by_degree(self, vertices: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield positions in `vertices` (N,) and the corners (degree, positions) of these vertices, for vertices of equal degree.

        Vertices without triangles or with more than MAX_DEGREE are left out. A group is at most as large as fits in the CPU cache.
        """
        degrees = self.starts[vertices + 1] - self.starts[vertices]
        for degree in range(1, MAX_DEGREE + 1):
            members = np.flatnonzero(degrees == degree)
            size = max(CHUNK_ENTRIES // degree, 1)
            for first in range(0, len(members), size):
                positions = members[first : first + size]
                yield positions, self.corners[self.starts[vertices[positions]] + np.arange(degree, dtype=np.int32)[:, None]]


def build_rings(triangles: np.ndarray, vertex_count: int) -> VertexRings:
    """Return the rings of the counterclockwise `triangles` (T, 3) int32."""
    corner_count = 3 * len(triangles)
    by_triangle = sparse.csr_matrix(
        (np.arange(corner_count, dtype=np.int32), triangles.ravel(), np.arange(0, corner_count + 1, 3, dtype=np.int32)),
        shape=(len(triangles), vertex_count),
    )
    by_vertex = by_triangle.tocsc()  # a counting sort
    return VertexRings(by_vertex.indptr, by_vertex.data, triangles[:, [1, 2, 0]].ravel(), triangles[:, [2, 0, 1]].ravel())
