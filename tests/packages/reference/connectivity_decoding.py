"""Triangles of levels from the symbols of `core.packages.mesh.connectivity`; page/mesh_decoding.js does the same in browsers."""

from dataclasses import dataclass

import numpy as np
from reference.sections import IntegerReader, damage, decode_signed

from farfield.addon.core.packages.mesh.connectivity import (
    ADDED_WEDGE,
    CANDIDATE,
    EXPLICIT_PARENT,
    FIRST,
    RING,
    SAME_WEDGE,
    SECOND,
    THIRD,
    CoarseFans,
)
from farfield.addon.core.packages.mesh.traversal import BOTH, BOUNDARY, LEFT, NEW, OTHER, RIGHT

Triple = tuple[int, int, int]


@dataclass(frozen=True)
class LevelStreams:
    """What `LevelSymbols` are read from; see there."""

    symbols: bytes
    vertices: IntegerReader
    wedges: IntegerReader
    parent_symbols: bytes
    parents: IntegerReader


class CandidateFans(CoarseFans):
    """Finds the vertices for which the encoder has found numbers."""

    def find_candidate(self, index: int, near: Triple) -> int:
        """Return the candidate `index`, -1 if there is none."""
        if index in (FIRST, SECOND):
            return near[index]
        if index == THIRD:
            return self._find_third(near)
        slot = self._starts[near[0]] + index - RING
        return self._nexts[slot] if slot < self._starts[near[0] + 1] else -1


class ConnectivityDecoder:
    """Decodes the levels of a mesh one after the other.

    wedge_vertices: the vertex of each wedge so far. parents: of each vertex so far, -1 in the coarsest level. triangles: three wedges of
    each triangle of the last level. vertex_references, wedge_references: of the vertices and wedges that it adds, see `LevelSymbols`.
    """

    def __init__(self) -> None:
        self.wedge_vertices: list[int] = []
        self.parents: list[int] = []
        self.triangles: list[int] = []
        self.vertex_references: list[Triple] = []
        self.wedge_references: list[Triple] = []
        self._next_wedges: list[int] = []
        self._first_wedges: list[int] = []

    def decode(self, streams: LevelStreams, triangle_counts: tuple[int, ...], vertex_count: int) -> None:
        """Decode the next level, with so many triangles per material, and so many vertices together with those of coarser levels.

        Raises:
            FileError: the symbols contradict themselves or the counts.
        """
        self._streams = streams
        self._known_count, self._vertex_count = len(self.parents), vertex_count
        corners = np.array([self.wedge_vertices[wedge] for wedge in self.triangles], np.int64).reshape(-1, 3)
        self._fans = CandidateFans(corners, self._known_count)
        self._latest = self._first_wedges.copy()
        self._met: list[int] = []
        self._is_met = [False] * vertex_count
        self._last_known = self._last_vertex = self._last_wedge = 0
        self.triangles, self.vertex_references, self.wedge_references = [], [], []
        self._border = _Border()
        self._symbol_count = 0
        for count in triangle_counts:
            end = len(self.triangles) + 3 * count
            while len(self.triangles) < end:
                if self._border.stack:
                    self._examine(self._border.stack.pop())
                else:
                    self._start()
            self._border.stack.clear()
        is_at_end = all(reader.is_at_end for reader in (streams.vertices, streams.wedges, streams.parents))
        if not is_at_end or self._symbol_count != len(streams.symbols) or len(self.parents) != vertex_count:
            raise damage()

    def _start(self) -> None:
        """Add a triangle with a loop of its own."""
        wedges = []
        for _ in range(3):
            vertex = self._read_vertex()
            if vertex == len(self.parents):
                wedges.append(self._add_vertex((self._last_vertex,) * 3, (self._last_wedge,) * 3))
            else:
                wedges.append(self._read_wedge(self._latest[vertex], None))
            self._mark_met(vertex)
        self.triangles += wedges
        a, b, c = wedges
        edges = [self._add_edge(b, a, c), self._add_edge(a, c, b), self._add_edge(c, b, a)]
        for edge, following in zip(edges, (*edges[1:], edges[0]), strict=True):
            self._border.link(edge, following)

    def _examine(self, edge: int) -> None:
        """Read whether an edge of the border has a triangle, and add it."""
        border = self._border
        if not border.is_listed[edge]:
            return
        if self._symbol_count >= len(self._streams.symbols):
            raise damage()
        symbol = self._streams.symbols[self._symbol_count]
        self._symbol_count += 1
        if symbol == BOUNDARY:
            return
        start, end, apex = border.starts[edge], border.ends[edge], border.apexes[edge]
        a = self._read_wedge(start, None)
        b = self._read_wedge(end, None)
        is_smooth = (a, b) == (start, end)
        before, after = border.previous[edge], border.following[edge]
        border.is_listed[edge] = False
        if symbol in (RIGHT, LEFT, BOTH):
            source = border.starts[before] if symbol == LEFT else border.ends[after]
            c = self._read_wedge(source, (a, b, apex) if is_smooth else None)
            if symbol == BOTH:
                border.is_listed[after] = border.is_listed[before] = False
                border.link(border.previous[before], border.following[after])
            elif symbol == RIGHT:
                border.is_listed[after] = False
                added, beyond = self._add_edge(a, c, b), border.following[after]
                border.link(before, added)
                border.link(added, beyond)
            else:
                border.is_listed[before] = False
                added = self._add_edge(c, b, a)
                border.link(border.previous[before], added)
                border.link(added, after)
        else:
            c = self._attach(symbol, (a, b, apex), is_smooth)
            met_edge = border.outgoing.get(self.wedge_vertices[c], -1) if symbol == OTHER else -1
            left, right = self._add_edge(a, c, b), self._add_edge(c, b, a)
            if met_edge >= 0 and border.is_listed[met_edge]:
                joined = border.previous[met_edge]
                border.link(left, met_edge)
                border.link(joined, right)
            else:
                border.link(left, right)
            border.link(before, left)
            border.link(right, after)
        self.triangles += (a, b, c)

    def _attach(self, symbol: int, corners: Triple, is_smooth: bool) -> int:
        """Return the third wedge of a triangle whose vertex does not follow from the border. corners: start, end and apex."""
        near = tuple(self.wedge_vertices[wedge] for wedge in corners)
        references = corners if is_smooth else (corners[1],) * 3
        if symbol == NEW:
            vertex = len(self.parents)
            wedge = self._add_vertex(near, references)
        else:
            vertex = self._read_vertex() if symbol == OTHER else self._find_candidate(symbol - CANDIDATE, near)
            if vertex >= len(self.parents):
                raise damage()
            wedge = self._read_wedge(self._latest[vertex], references)
        self._mark_met(vertex)
        return wedge

    def _find_candidate(self, index: int, near: Triple) -> int:
        if not self._known_count:
            raise damage()
        candidate = self._fans.find_candidate(index, tuple(self._find_family(vertex) for vertex in near))
        if candidate < 0:
            raise damage()
        return candidate

    def _find_family(self, vertex: int) -> int:
        """Return the vertex of coarser levels to which `vertex` belongs: itself or its parent."""
        return vertex if vertex < self._known_count else self.parents[vertex]

    def _read_vertex(self) -> int:
        value = self._streams.vertices.read()
        if value == 0:
            return len(self.parents)
        if value & 1:
            rank = len(self._met) - 1 - value // 2
            if rank < 0:
                raise damage()
            return self._met[rank]
        vertex = self._last_known + decode_signed(value // 2 - 1)
        if not 0 <= vertex < self._known_count:
            raise damage()
        return vertex

    def _mark_met(self, vertex: int) -> None:
        self._last_vertex = vertex
        if not self._is_met[vertex]:
            self._is_met[vertex] = True
            self._met.append(vertex)
            if vertex < self._known_count:
                self._last_known = vertex

    def _add_vertex(self, references: Triple, wedge_references: Triple) -> int:
        """Return the first wedge of an added vertex."""
        vertex, wedge = len(self.parents), len(self.wedge_vertices)
        if vertex >= self._vertex_count:
            raise damage()
        self.parents.append(self._read_parent(references) if self._known_count else -1)
        self.vertex_references.append(references)
        self.wedge_references.append(wedge_references)
        self.wedge_vertices.append(vertex)
        self._next_wedges.append(wedge)
        self._first_wedges.append(wedge)
        self._latest.append(wedge)
        self._last_wedge = wedge
        return wedge

    def _read_parent(self, references: Triple) -> int:
        symbol = self._streams.parent_symbols[len(self.parents) - self._known_count]
        if symbol != EXPLICIT_PARENT:
            return self._find_candidate(symbol, references)
        parent = self._find_family(references[0]) + decode_signed(self._streams.parents.read())
        if not 0 <= parent < self._known_count:
            raise damage()
        return parent

    def _read_wedge(self, predicted: int, references: Triple | None) -> int:
        """Return the wedge of a vertex for which `predicted` is a wedge."""
        code = self._streams.wedges.read()
        wedge = predicted
        if code == ADDED_WEDGE:
            wedge = len(self.wedge_vertices)
            self.wedge_vertices.append(self.wedge_vertices[predicted])
            self._next_wedges.append(self._next_wedges[predicted])
            self._next_wedges[predicted] = wedge
            self.wedge_references.append((self._last_wedge,) * 3 if references is None else references)
        elif code != SAME_WEDGE:
            for _ in range(code - ADDED_WEDGE):
                wedge = self._next_wedges[wedge]
                if wedge == predicted:
                    raise damage()
        self._latest[self.wedge_vertices[wedge]] = self._last_wedge = wedge
        return wedge

    def _add_edge(self, start: int, end: int, apex: int) -> int:
        return self._border.add(start, end, apex, self.wedge_vertices[start])


class _Border:
    """The border of the triangles so far: edges with the wedges, in the triangle inside, of their start, their end and opposite to them."""

    def __init__(self) -> None:
        self.starts: list[int] = []
        self.ends: list[int] = []
        self.apexes: list[int] = []
        self.previous: list[int] = []
        self.following: list[int] = []
        self.is_listed: list[bool] = []
        self.stack: list[int] = []
        self.outgoing: dict[int, int] = {}

    def add(self, start: int, end: int, apex: int, vertex: int) -> int:
        edge = len(self.starts)
        self.starts.append(start)
        self.ends.append(end)
        self.apexes.append(apex)
        self.previous.append(edge)
        self.following.append(edge)
        self.is_listed.append(True)
        self.stack.append(edge)
        self.outgoing[vertex] = edge
        return edge

    def link(self, edge: int, following: int) -> None:
        self.following[edge], self.previous[following] = following, edge
