"""The pair of right-triangle bintrees over the root square (BDAM, section 3).

Level 0 has two triangles, the halves of the root square. A triangle with the index i is bisected from its right angle to the midpoint of
its hypotenuse into the triangles 2 i and 2 i + 1 of the next level. At even levels the legs are parallel to the axes, at odd levels the
hypotenuse is. The triangles of a level within any coarser triangle have consecutive indices, so that ascending indices follow a
space-filling curve.
The two triangles on both sides of a hypotenuse form a diamond; at the boundary of the root square a diamond has one triangle.
"""

from dataclasses import dataclass

import numpy as np


def bisect(corners: np.ndarray, is_second: np.ndarray) -> np.ndarray:
    """Return the corners (N, 3, 2) of the first or second child of triangles with `corners` (N, 3, 2); see `Tree.triangle_corners`."""
    start, end, apex = corners.transpose(1, 0, 2)
    center, is_second = (start + end) // 2, is_second[:, None]
    return np.stack([np.where(is_second, end, apex), np.where(is_second, apex, start), center], axis=1)


@dataclass(frozen=True)
class Tree:
    """The bintrees over a field of `rows` x `columns` samples.

    leaf_cells: cells along a leg of a leaf, even. The root square begins at the sample (0, 0) and may extend beyond the field; triangles
    that do not overlap the field do not exist.
    """

    rows: int
    columns: int
    leaf_cells: int

    @property
    def depth(self) -> int:
        """The number of times that the root square is halved; leaves are at level 2 * depth."""
        cells, depth = max(self.rows, self.columns) - 1, 0
        while self.leaf_cells << depth < cells:
            depth += 1
        return depth

    @property
    def leaf_level(self) -> int:
        """The finest level, where patches contain all samples."""
        return 2 * self.depth

    @property
    def side(self) -> int:
        """The side of the root square in cells."""
        return self.leaf_cells << self.depth

    def triangle_corners(self, level: int, indices: np.ndarray) -> np.ndarray:
        """Return the corners (N, 3, 2) int64 in grid coordinates (x, y): both ends of the hypotenuse, then the right angle,
        counterclockwise.

        Args:
            indices: (N,) int, 0 to 2**(level + 1) - 1.
        """
        side = self.side
        roots = np.array([[(side, side), (0, 0), (side, 0)], [(0, 0), (side, side), (0, side)]], np.int64)
        corners = roots[indices >> level]
        for bit in range(level - 1, -1, -1):
            corners = bisect(corners, ((indices >> bit) & 1).astype(bool))
        return corners

    def corners_of(self, level: int, index: int) -> np.ndarray:
        """Return the corners (3, 2) int64 of one triangle; see `triangle_corners`, which takes 20 times as long for one."""
        side = self.side
        start, end, apex = ((0, 0), (side, side), (0, side)) if index >> level else ((side, side), (0, 0), (side, 0))
        for bit in range(level - 1, -1, -1):
            center = (start[0] + end[0]) // 2, (start[1] + end[1]) // 2
            start, end, apex = (end, apex, center) if index >> bit & 1 else (apex, start, center)
        return np.array([start, end, apex], np.int64)

    def existing_triangles(self, level: int) -> np.ndarray:
        """Return the ascending indices (N,) int64 of the triangles of a level that overlap the field with a positive area."""
        indices = np.arange(2, dtype=np.int64)
        for current in range(level + 1):
            if current:
                indices = (2 * indices[:, None] + np.arange(2)).ravel()
            indices = indices[self._overlaps_field(self.triangle_corners(current, indices))]
        return indices

    def find_diamonds(self, level: int, indices: np.ndarray) -> np.ndarray:
        """Return the diamonds (D, 2) int64 of triangles: positions in `indices` (N,), the second one -1 for single triangles.

        Diamonds are in the order of their first triangles.
        """
        corners = self.triangle_corners(level, indices)
        centers = (corners[:, 0] + corners[:, 1]) // 2
        keys = centers[:, 1] * (2 * self.side) + centers[:, 0]
        order = np.argsort(keys, kind="stable")
        is_same = np.append(keys[order][1:] == keys[order][:-1], False)
        is_first = np.append(True, ~is_same[:-1])
        diamonds = np.stack([order[is_first], np.where(is_same, np.append(order[1:], -1), -1)[is_first]], axis=1)
        return diamonds[np.argsort(diamonds[:, 0])]

    def _overlaps_field(self, corners: np.ndarray) -> np.ndarray:
        """Return whether triangles (N, 3, 2) overlap the field: whether the corner of the clipped bounding box that is farthest from the
        hypotenuse on the side of the triangle is strictly inside of it, for every edge."""
        low = np.minimum(corners.min(axis=1), [self.columns - 1, self.rows - 1])
        high = np.minimum(corners.max(axis=1), [self.columns - 1, self.rows - 1])
        overlaps = (high > low).all(axis=1)
        for edge in range(3):
            start, end = corners[:, edge], corners[:, (edge + 1) % 3]
            direction = end - start
            farthest = np.stack(
                [np.where(direction[:, 1] < 0, high[:, 0], low[:, 0]), np.where(direction[:, 0] > 0, high[:, 1], low[:, 1])], axis=1
            )
            overlaps &= direction[:, 0] * (farthest - start)[:, 1] - direction[:, 1] * (farthest - start)[:, 0] > 0
        return overlaps
