"""The triangles around the vertices of a level, among which an added vertex of the next finer level finds its parent.

Collapses map each triangle of the finer level to a triangle of the coarser one, to an edge or to a vertex. So the third vertex of a
triangle belongs to the first or second one, or to the vertex on their side of the edge between these, or is next to them.
"""

import numpy as np

FIRST, SECOND, THIRD, RING = range(4)  # candidates: RING + k is the next vertex in the triangle k of the fan of the first one
MAX_CANDIDATE = 239


class CoarseFans:
    """Fans of the vertices of a level: triangles in ascending order."""

    def __init__(self, triangles: np.ndarray, vertex_count: int) -> None:
        """triangles: (T, 3) vertices below `vertex_count`."""
        corners = triangles.reshape(-1)
        order = np.argsort(corners, kind="stable")
        self._starts = np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=vertex_count))]).tolist()
        self._nexts = np.roll(triangles, -1, axis=1).reshape(-1)[order].tolist()
        self._thirds = np.roll(triangles, -2, axis=1).reshape(-1)[order].tolist()

    def find_index(self, vertex: int, near: tuple[int, int, int]) -> int:
        """Return which candidate `vertex` is, -1 if it is none. near: the vertices to which start, end and apex of an edge belong."""
        first, second, _ = near
        if vertex == first:
            return FIRST
        if vertex == second:
            return SECOND
        if vertex == self._find_third(near):
            return THIRD
        begin, end = self._starts[first], min(self._starts[first + 1], self._starts[first] + MAX_CANDIDATE + 1 - RING)
        for slot in range(begin, end):
            if self._nexts[slot] == vertex:
                return RING + slot - begin
        return -1

    def find_candidate(self, index: int, near: tuple[int, int, int]) -> int:
        """Return the candidate `index`, -1 if there is none."""
        if index in (FIRST, SECOND):
            return near[index]
        if index == THIRD:
            return self._find_third(near)
        slot = self._starts[near[0]] + index - RING
        return self._nexts[slot] if slot < self._starts[near[0] + 1] else -1

    def _find_third(self, near: tuple[int, int, int]) -> int:
        first, second, apex = near
        if first != second:
            for slot in range(self._starts[first], self._starts[first + 1]):
                if self._nexts[slot] == second:
                    return self._thirds[slot]
        return apex
