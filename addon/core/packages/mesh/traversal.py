"""Order of the triangles of a level in which each continues a border of those before it.

A traversal as in Edgebreaker (Rossignac, "Edgebreaker: connectivity compression for triangle meshes", 1999), made robust: the border is a
set of doubly linked loops of edges, a triangle attaches to the edge that was added last, and joins the neighboring edges of the border if
they have its third vertex. Parts that are not manifold are attached as far as possible, and the rest starts a new loop.
"""

from dataclasses import dataclass

import numpy as np

NEW, RIGHT, LEFT, BOTH, BOUNDARY, OTHER = range(6)  # the third vertex of the triangle at an edge of the border, or none


@dataclass(frozen=True)
class Traversal:
    """T triangles in their order, and the G symbols of the edges of the border in the order in which they were examined.

    Corner 3 t + c of the triangles that were given is called c below; edge c goes from it to the next corner of the triangle.

    first_corners: (T,) the corner that becomes the first one. The first two are those at the edge of the border; the third one is new to
    it. across: (T,) the corner of another triangle at whose edge the triangle is attached, -1 for the first triangle of a loop.
    third_sources: (T,) the corner whose vertex and, unless there is a seam, whose wedge the third corner has; -1 if that does not
    follow from the border. symbols: (G,) uint8; NEW and OTHER say that the third vertex is met for the first time, or once more.
    """

    first_corners: np.ndarray
    across: np.ndarray
    third_sources: np.ndarray
    symbols: np.ndarray


def find_opposite_halfedges(triangles: np.ndarray, materials: np.ndarray) -> np.ndarray:
    """Return for each halfedge 3 t + c of `triangles` (T, 3), from corner c to the next one, the opposite one, (3 T,); -1 if it has none.

    It has the same ends, the opposite direction and the same material. No two halfedges have the same opposite one.
    """
    starts, ends = triangles.reshape(-1).astype(np.int64), np.roll(triangles, -1, axis=1).reshape(-1)
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    size = int(triangles.max(initial=0)) + 1
    keys = (np.repeat(materials.astype(np.int64), 3) * size + low) * size + high
    order = np.argsort(2 * keys + (starts > ends), kind="stable")
    keys, is_backward = keys[order], (starts > ends)[order]
    group_starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    group = np.cumsum(np.concatenate([[0], (keys[1:] != keys[:-1]).astype(np.int64)]))
    forward_counts = np.bincount(group[~is_backward], minlength=len(group_starts))
    rank = np.arange(len(keys)) - group_starts[group] - np.where(is_backward, forward_counts[group], 0)
    forward, backward = np.flatnonzero(~is_backward), np.flatnonzero(is_backward)
    forward_keys = group[forward] * (len(keys) + 1) + rank[forward]
    backward_keys = group[backward] * (len(keys) + 1) + rank[backward]
    _, first, second = np.intersect1d(forward_keys, backward_keys, assume_unique=True, return_indices=True)
    opposite = np.full(len(starts), -1, np.int64)
    first, second = order[forward[first]], order[backward[second]]
    opposite[first], opposite[second] = second, first
    return opposite


def traverse(triangles: np.ndarray, materials: np.ndarray) -> Traversal:
    """Return the traversal of `triangles` (T, 3), those of one material after those of another, in ascending order.

    materials: (T,).
    """
    opposite = find_opposite_halfedges(triangles, materials).tolist()
    border = _Border(triangles.reshape(-1).tolist(), opposite)
    for material in np.unique(materials):
        for triangle in np.flatnonzero(materials == material).tolist():
            if not border.is_visited[triangle]:
                border.start(triangle)
                border.grow()
        del border.symbols[border.symbol_count :]  # nothing needs to be known after the last triangle of a material
    columns = (border.first_corners, border.across, border.third_sources)
    return Traversal(*(np.array(column, np.int64) for column in columns), np.array(border.symbols, np.uint8))


class _Border:
    """The border of the triangles so far: edges with their start, their end, the previous and the next edge, and the halfedge inside, which
    goes from the end to the start of the edge."""

    def __init__(self, corners: list[int], opposite: list[int]) -> None:
        self.corners, self.opposite = corners, opposite
        count = len(corners)
        self.starts, self.ends, self.previous, self.following, self.inner = ([0] * count for _ in range(5))
        self.is_listed = [False] * count  # whether the edge is still in a loop
        self.count = 0
        self.stack: list[int] = []
        self.outgoing: dict[int, int] = {}
        self.is_met: set[int] = set()
        self.is_visited = [False] * (count // 3)
        self.first_corners: list[int] = []
        self.across: list[int] = []
        self.third_sources: list[int] = []
        self.symbols: list[int] = []
        self.symbol_count = 0  # up to the last triangle

    def start(self, triangle: int) -> None:
        """Add a triangle with a loop of its own."""
        first = 3 * triangle
        self.is_visited[triangle] = True
        self.symbol_count = len(self.symbols)
        self.first_corners.append(first)
        self.across.append(-1)
        self.third_sources.append(-1)
        self.is_met.update(self.corners[first : first + 3])
        edges = [self._add(halfedge) for halfedge in (first, first + 2, first + 1)]
        for edge, following in zip(edges, (*edges[1:], edges[0]), strict=True):
            self._link(edge, following)

    def grow(self) -> None:
        """Attach triangles until no edge of the border has one."""
        corners, opposite, is_visited, is_listed, following, previous = (
            self.corners,
            self.opposite,
            self.is_visited,
            self.is_listed,
            self.following,
            self.previous,
        )
        stack, symbols, is_met, inner = self.stack, self.symbols, self.is_met, self.inner
        while stack:
            edge = stack.pop()
            if not is_listed[edge]:
                continue
            halfedge = opposite[inner[edge]]
            if halfedge < 0 or is_visited[halfedge // 3]:
                symbols.append(BOUNDARY)
                continue
            triangle, corner = divmod(halfedge, 3)
            second, third = 3 * triangle + (corner + 1) % 3, 3 * triangle + (corner + 2) % 3
            vertex = corners[third]
            after, before = following[edge], previous[edge]
            is_right, is_left = self.ends[after] == vertex, self.starts[before] == vertex
            is_visited[triangle] = True
            self.first_corners.append(halfedge)
            self.across.append(inner[edge])
            is_listed[edge] = False
            source = -1
            if is_right and is_left and after != before:
                symbols.append(BOTH)
                source = inner[after]
                is_listed[after] = is_listed[before] = False
                self._link(previous[before], following[after])
            elif is_right:
                symbols.append(RIGHT)
                source = inner[after]
                is_listed[after] = False
                added = self._add(third)
                beyond = following[after]
                self._link(before, added)
                self._link(added, beyond)
            elif is_left:
                symbols.append(LEFT)
                source = inner[before] - inner[before] % 3 + (inner[before] + 1) % 3
                is_listed[before] = False
                added = self._add(second)
                beyond = previous[before]
                self._link(beyond, added)
                self._link(added, after)
            else:
                met_edge = -1
                if vertex in is_met:
                    symbols.append(OTHER)
                    met_edge = self.outgoing.get(vertex, -1)
                else:
                    symbols.append(NEW)
                    is_met.add(vertex)
                left, right = self._add(third), self._add(second)
                if met_edge >= 0 and is_listed[met_edge]:
                    joined = previous[met_edge]
                    self._link(left, met_edge)
                    self._link(joined, right)
                else:
                    self._link(left, right)
                self._link(before, left)
                self._link(right, after)
            self.third_sources.append(source)
            self.symbol_count = len(symbols)

    def _add(self, halfedge: int) -> int:
        """Add an edge outside of `halfedge`, with its opposite direction."""
        edge = self.count
        self.count += 1
        first = halfedge - halfedge % 3
        start, end = self.corners[first + (halfedge + 1) % 3], self.corners[halfedge]
        self.starts[edge], self.ends[edge], self.inner[edge], self.is_listed[edge] = start, end, halfedge, True
        self.outgoing[start] = edge
        self.stack.append(edge)
        return edge

    def _link(self, edge: int, following: int) -> None:
        self.following[edge], self.previous[following] = following, edge
