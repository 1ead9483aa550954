"""Which of many triangles in the plane contains a point."""

import numpy as np

from ..arrays import concatenate_ranges

TOLERANCE = 1e-9  # Barycentric coordinates may be this negative: points on an edge are in both triangles in spite of rounding.
TRIANGLES_PER_BUCKET = 2.0
MAX_MEMBERS = 1 << 20  # triangles of all buckets; long thin ones are in many, and then there are fewer buckets
MAX_CANDIDATES = 1 << 22  # pairs of a point and a triangle that are tested at once


class TriangleSearch:
    """Triangles in a grid of buckets, each with the triangles whose bounding boxes overlap it."""

    def __init__(self, positions: np.ndarray, triangles: np.ndarray) -> None:
        """positions: (V, 2) float64. triangles: (T, 3) int, counterclockwise, at least one; those without area contain nothing."""
        corners = positions[triangles]
        self._low = corners.min(axis=(0, 1))
        extent = np.maximum(corners.max(axis=(0, 1)) - self._low, np.finfo(np.float64).tiny)
        self._extent = extent
        self._count = max(1, int((len(triangles) / TRIANGLES_PER_BUCKET) ** 0.5))
        self._origins = corners[:, 0]
        self._edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        (ux, uy), (vx, vy) = (edge.T for edge in self._edges)
        self._areas = ux * vy - uy * vx
        while True:
            first, last = self._bucket_positions(corners.min(axis=1)), self._bucket_positions(corners.max(axis=1))
            widths, heights = (last - first + 1).T
            counts = widths * heights
            if counts.sum() <= MAX_MEMBERS or self._count == 1:
                break
            self._count //= 2
        members = np.repeat(np.arange(len(triangles)), counts)
        offsets = concatenate_ranges(0, counts)
        columns, rows = first[members, 0] + offsets % widths[members], first[members, 1] + offsets // widths[members]
        buckets = rows * self._count + columns
        self._members = members[np.argsort(buckets, kind="stable")].astype(np.int32)
        self._starts = np.concatenate([[0], np.cumsum(np.bincount(buckets, minlength=self._count**2))])

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        arrays = (self._origins, *self._edges, self._areas, self._members, self._starts)
        return sum(array.nbytes for array in arrays)

    def find(self, points: np.ndarray) -> np.ndarray:
        """Return for each of `points` (N, 2) float64 the index of a triangle that contains it, (N,) int64, or -1.

        On a common edge it is the triangle that the point is deepest in.
        """
        of_point, triangles, depths = self.find_all(points)
        order = np.lexsort((-depths, of_point))
        inside, first = np.unique(of_point[order], return_index=True)
        found = np.full(len(points), -1, np.int64)
        found[inside] = triangles[order][first]
        return found

    def find_all(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all pairs of one of `points` (N, 2) float64 and a triangle that contains it: the indices of both, (P,) int64, and how
        deep the point is in the triangle, its smallest barycentric coordinate, (P,) float64."""
        buckets = self._bucket_positions(points)
        buckets = buckets[:, 1] * self._count + buckets[:, 0]
        counts = self._starts[buckets + 1] - self._starts[buckets]
        parts = np.flatnonzero(np.diff(np.cumsum(counts) // MAX_CANDIDATES, prepend=0)) if counts.sum() > MAX_CANDIDATES else []
        split = (np.split(array, parts) for array in (np.arange(len(points)), buckets, counts))
        found = [self._find_part(points, *part) for part in zip(*split, strict=True)]
        return tuple(np.concatenate(arrays) for arrays in zip(*found, strict=True))

    def _find_part(
        self, points: np.ndarray, indices: np.ndarray, buckets: np.ndarray, counts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Do `find_all` for the points at `indices` in `buckets` (N,) with `counts` (N,) of triangles, whose sum bounds the memory."""
        of_point = np.repeat(indices, counts)
        candidates = self._members[concatenate_ranges(self._starts[buckets], counts)]
        depths = self._measure_depths(points[of_point], candidates)
        is_inside = depths >= -TOLERANCE
        return of_point[is_inside], candidates[is_inside].astype(np.int64), depths[is_inside]

    def _bucket_positions(self, points: np.ndarray) -> np.ndarray:
        """Return columns and rows (N, 2) int64 of the buckets of points, of the nearest ones outside of the grid."""
        return np.clip((points - self._low) * (self._count / self._extent), 0, self._count - 1).astype(np.int64)

    def _measure_depths(self, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """Return the smallest of the barycentric coordinates (N,) of points in one triangle each, minus infinity without area."""
        x, y = (points - self._origins[triangles]).T
        (ux, uy), (vx, vy) = (edge[triangles].T for edge in self._edges)
        areas = self._areas[triangles]
        with np.errstate(divide="ignore", invalid="ignore"):
            second, third = (x * vy - y * vx) / areas, (ux * y - uy * x) / areas
            depths = np.minimum(np.minimum(second, third), 1.0 - second - third)
        return np.where(areas > 0.0, depths, -np.inf)


def evaluate_planes(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return heights (N,) and unit normals (N, 3) at `points` (N, 2) on the planes of triangles (N, 3, 3), counterclockwise from above.
    Both are NaN where a triangle has no area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offsets = points - corners[:, 0, :2]
    normals[normals[:, 2] <= 0.0] = np.nan
    heights = corners[:, 0, 2] - (normals[:, :2] * offsets).sum(axis=1) / normals[:, 2]
    return heights, normals / np.linalg.norm(normals, axis=1, keepdims=True)
