"""Half-edge collapses in a height field, and the vertical distances from the removed vertices to the new triangles.

A collapse moves a vertex onto one of its neighbors, the target. Its star is replaced by a fan of triangles around the target, which is
valid if all of them are counterclockwise in the plane.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import gather
from ...geometry.vertex_rings import VertexRings

FREE, HORIZONTAL, VERTICAL, DIAGONAL, ANTIDIAGONAL, LOCKED = range(6)  # what a vertex may move along
DIRECTIONS = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (1, -1), (0, 0)], np.float32)
MAX_ENTRIES = 1 << 16  # entries of a (targets, triangles, vertices) array
TARGET_BITS = np.int32(31)  # the low bits of a cost store the row of its target; MAX_DEGREE is less
INFINITY_BITS = np.float32(np.inf).view(np.int32)


@dataclass(frozen=True)
class GridPoints:
    """Samples of a height field.

    x, y: (V,), integers as float32 or float64, such that products of differences are exact. z: (V,) float32, heights in any unit.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray

    @property
    def real(self) -> np.dtype:
        """The dtype of the coordinates."""
        return self.x.dtype

    def subtract(self, ends: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the components of the vectors from vertices `starts` (N,) to `ends` (N,) or (K, N)."""
        x, y, z = gather(self.x, ends), gather(self.y, ends), gather(self.z, ends)
        x -= gather(self.x, starts)
        y -= gather(self.y, starts)
        z -= gather(self.z, starts)
        return x, y, z


def find_targets(points: GridPoints, rings: VertexRings, lines: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find for each vertex the valid target with the least vertical distance from the vertex to the new triangles.

    Args:
        lines: (V,) int8, FREE or the line along which a vertex may move. vertices: (N,) intp.

    Returns:
        Targets (N,) intp and distances (N,) float32 with a relative precision of 2e-6, infinite where no target is valid.
    """
    targets, costs = np.zeros(len(vertices), np.intp), np.full(len(vertices), np.inf, np.float32)
    for positions, corners in rings.group_by_degree(vertices, MAX_ENTRIES, 2):
        v = gather(vertices, positions)
        after, before = gather(rings.next, corners), gather(rings.previous, corners)
        ax, ay, az = points.subtract(after, v)
        distances, is_valid = _measure_collapses(after, before, (ax, ay, az), points.subtract(before, v))
        of_line = gather(lines, v)
        bound = np.flatnonzero(of_line)
        if len(bound):
            line_x, line_y = DIRECTIONS.take(of_line.take(bound), axis=0).T
            is_valid[:, bound] &= ax.take(bound, axis=1) * line_y == ay.take(bound, axis=1) * line_x
        # Costs that are not negative sort like their bits, so one minimum finds the cost and its row.
        bits = np.where(is_valid, distances.view(np.int32), INFINITY_BITS)
        bits &= ~TARGET_BITS
        bits |= np.arange(len(after), dtype=np.int32)[:, None]
        best = bits.min(axis=0)
        targets[positions] = gather(after.reshape(-1), (best & TARGET_BITS).astype(np.intp) * len(v) + np.arange(len(v)))
        costs[positions] = (best & ~TARGET_BITS).view(np.float32)
    return targets, costs


def _measure_collapses(
    after: np.ndarray, before: np.ndarray, a: tuple[np.ndarray, np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the collapse of vertices onto the vertices `after` them.

    Args:
        after, before: (K, N) intp, the other vertices of the triangles of each vertex. a, b: their components (K, N), relative to the
        vertex.

    Returns:
        Distances (K, N) float32 from the vertices to the new triangles, and whether all of these are counterclockwise.
    """
    (ax, ay, az), (bx, by, bz) = a, b
    areas = ax * by - ay * bx
    to_after = ax[:, None] * ay  # (targets, triangles, vertices)
    to_after -= ay[:, None] * ax
    to_before = ax[:, None] * by
    to_before -= ay[:, None] * bx
    new_areas = to_after - to_before
    new_areas += areas
    # The triangles that contain the target collapse to an exact area of 0: two, or one at the first edge of a border.
    is_border = after.sum(axis=0) != before.sum(axis=0)
    kept_count = np.add.reduce((new_areas > 0).view(np.int8), axis=1, dtype=np.int8)
    is_valid = kept_count == len(after) - 2 + is_border
    contains = to_after >= 0
    contains &= to_before <= 0
    heights = areas * az[:, None]
    to_before *= az
    heights -= to_before
    to_after *= bz
    heights += to_after
    heights *= contains
    heights /= np.maximum(new_areas, np.ones_like(new_areas), out=new_areas)  # areas are integers
    return np.abs(heights, out=heights).max(axis=1).astype(np.float32), is_valid
