"""Distances of points to triangles that move a little from one search to the next, as in optimizations of a mesh."""

import numpy as np

from .distance import TriangleTree, segment_argmin, squared_point_triangle_distances

MAX_UNCERTAIN = 0.1  # Fraction of the points that are searched for among all triangles one by one; if there are more, all start again.


class TrackedPoints:
    """Fixed `points` (N, 3) that remember the triangles near them.

    These are all that were within a `reach` beyond the nearest one. No other triangle is the nearest as long as the triangles have moved
    too little to bridge that reach, as in the neighbor lists of molecular dynamics (Verlet 1967). Other points are searched for again.
    """

    def __init__(self, points: np.ndarray, reach: float) -> None:
        self.points = points
        self._reach = reach
        self._corners = np.zeros((0, 3, 3))

    def find_closest(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (N,) of the points and the nearest of the triangles `corners` (T, 3, 3), int32, see `closest_on_mesh`.

        The triangles with the same indices in the search before should be nearby.
        """
        if corners.shape != self._corners.shape:
            return self._start(corners)
        moved = np.sqrt(((corners - self._corners) ** 2).sum(axis=2).max())
        squared = squared_point_triangle_distances(self.points[self._point], corners[self._triangle])
        first = segment_argmin(squared, self._starts)
        distances, nearest = np.sqrt(squared[first]), self._triangle[first]
        uncertain = np.flatnonzero(distances > self._limits - moved)
        if len(uncertain) > MAX_UNCERTAIN * len(self.points):
            return self._start(corners)
        if len(uncertain):
            distances[uncertain], nearest[uncertain] = TriangleTree(corners).find_closest(self.points[uncertain])
        return distances, nearest

    def _start(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what `find_closest` does, and remember the triangles near the points."""
        self._point, triangle, distances = TriangleTree(corners).find_near(self.points, self._reach)
        self._corners, self._triangle = corners, triangle.astype(np.int32)
        self._starts = np.flatnonzero(np.diff(self._point, prepend=-1))
        first = segment_argmin(distances, self._starts)
        self._limits = distances[first] + self._reach
        return distances[first], self._triangle[first]
