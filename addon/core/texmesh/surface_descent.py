"""The point of a surface that is nearest to a point, found by descent from another point of the surface.

Unlike the nearest point of all, it lies on the same side of thin parts as the start.
"""

import numpy as np
from scipy.sparse import coo_array

from ..arrays import concatenate_ranges
from ..geometry.distance import closest_on_triangles, segment_argmin
from ..geometry.edges import find_edges
from ..geometry.mesh import face_areas_and_normals, longest_side

ON_EDGE = 1e-9  # barycentric coordinate below which a point is on an edge
RELATIVE_PRECISION = 1e-9  # Precision of distances, relative to the longest side of the surface.
MAX_STEPS = 400  # triangles that a descent crosses


class SurfaceDescent:
    """Triangles (T, 3) of `vertices` (V, 3)."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self._triangles = triangles
        self._corners = vertices[triangles]
        self._normals = face_areas_and_normals(self._corners)[1]
        self._precision = (RELATIVE_PRECISION * longest_side(vertices)) ** 2
        edges = find_edges(triangles, len(vertices))
        self._neighbors = np.full(triangles.size, -1, np.int64)  # The neighbors of halfedges.
        first, second = edges.interior_halfedges.T
        self._neighbors[first], self._neighbors[second] = second // 3, first // 3
        owners = np.repeat(np.arange(len(triangles)), 3)
        rings = coo_array((np.ones(triangles.size, bool), (triangles.ravel(), owners)), shape=(len(vertices), len(triangles))).tocsr()
        self._ring_starts, self._ring_triangles = rings.indptr.astype(np.int64), rings.indices.astype(np.int64)

    def find_nearest(self, points: np.ndarray, normals: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return triangles (N,) and barycentric coordinates (N, 3) of the points of the surface from which no step along it leads nearer to
        `points` (N, 3). The descent begins in `triangles` (N,) and enters only triangles that face the same side as `normals` (N, 3)."""
        triangles = triangles.copy()
        squares, second, third = closest_on_triangles(points, self._corners[triangles])
        barycentric = np.stack([1.0 - second - third, second, third], axis=1)
        active = np.flatnonzero(squares > self._precision)
        for _ in range(MAX_STEPS):
            rows, entered = self._find_entered(active, triangles, barycentric)
            is_open = np.einsum("ni,ni->n", self._normals[entered], normals[rows]) > 0.0
            rows, entered = rows[is_open], entered[is_open]
            if not len(rows):
                break
            found, second, third = closest_on_triangles(points[rows], self._corners[entered])
            best = segment_argmin(found, np.flatnonzero(np.diff(rows, prepend=-1)))
            best = best[found[best] < squares[rows[best]] - self._precision]
            active = rows[best]
            squares[active], triangles[active] = found[best], entered[best]
            barycentric[active] = np.stack([1.0 - second[best] - third[best], second[best], third[best]], axis=1)
        return triangles, barycentric

    def _find_entered(self, active: np.ndarray, triangles: np.ndarray, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows (K,), ascending, of `active` (M,) points, and the triangles (K,) that they may enter: those across the edge, or
        around the vertex, on which the points are now."""
        is_zero = barycentric[active] <= ON_EDGE
        zeros = is_zero.sum(axis=1)
        on_edge, on_vertex = active[zeros == 1], active[zeros >= 2]
        across = self._neighbors[3 * triangles[on_edge] + is_zero[zeros == 1].argmax(axis=1)]
        has_neighbor = across >= 0
        vertices = self._triangles[triangles[on_vertex], barycentric[on_vertex].argmax(axis=1)]
        starts = self._ring_starts[vertices]
        counts = self._ring_starts[vertices + 1] - starts
        rows = np.concatenate([on_edge[has_neighbor], np.repeat(on_vertex, counts)])
        entered = np.concatenate([across[has_neighbor], self._ring_triangles[concatenate_ranges(starts, counts)]])
        order = np.argsort(rows, kind="stable")
        return rows[order], entered[order]
