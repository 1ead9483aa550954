"""Symbols that encode the triangles of levels, and the references from which positions and texture coordinates are predicted.

The vertices and wedges that a level adds are numbered in the order in which its triangles meet them, so that most triangles are one symbol.
A vertex of a coarser level that is met is mostly the parent of an added vertex nearby. Collapses map each triangle of the finer level to a
triangle of the coarser one, to an edge or to a vertex. So the third vertex of a triangle belongs to the first or second one, or to the
vertex on their side of the edge between these, or is next to them.
"""

from dataclasses import dataclass

import numpy as np

from .order import OrderedLevel, OrderedMesh
from .sections import encode_integers, encode_signed
from .traversal import BOUNDARY, NEW, OTHER

CANDIDATE = 6  # the first of the symbols beyond those of `traversal`: the vertex is a candidate of `CoarseFans`
EXPLICIT_PARENT = 255  # symbol of a parent that is none of them
SAME_WEDGE, ADDED_WEDGE, OTHER_WEDGE = 0, 1, 2  # codes of wedges: the predicted one, an added one, the first of the others in the ring
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

    def _find_third(self, near: tuple[int, int, int]) -> int:
        first, second, apex = near
        if first != second:
            for slot in range(self._starts[first], self._starts[first + 1]):
                if self._nexts[slot] == second:
                    return self._thirds[slot]
        return apex


@dataclass(frozen=True)
class LevelSymbols:
    """The code of a level, given coarser ones.

    Attributes:
        symbols: one byte per examined edge of the border.
        vertices, wedges, parents: LEB128 integers: explicit vertices, codes of wedges, explicit parents.
        parent_symbols: one byte per added vertex.
        vertex_references: (N, 3) of the N added vertices: a position is predicted to be first + second - third.
        wedge_references: (M, 3), the same for the texture coordinates of the M added wedges.
    """

    symbols: bytes
    vertices: bytes
    wedges: bytes
    parent_symbols: bytes
    parents: bytes
    vertex_references: np.ndarray
    wedge_references: np.ndarray


class ConnectivityEncoder:
    """Encodes the levels of a mesh one after the other."""

    def __init__(self, ordered: OrderedMesh) -> None:
        self._wedge_vertices = ordered.wedge_vertices
        self._triangles = np.zeros((0, 3), np.int32)  # The triangles of the last level.
        self._vertices = ordered.wedge_vertices.tolist()
        self._parents = ordered.parents.tolist()
        self._next_wedges = list(range(len(self._vertices)))  # the next wedge of the same vertex, in a ring
        self._first_wedges: list[int] = []  # The first wedge of each vertex so far.
        self._wedge_count = 0

    def encode(self, level: OrderedLevel) -> LevelSymbols:
        """Return the code of the next `level`."""
        self._known_count, added = len(self._first_wedges), level.vertex_count - len(self._first_wedges)
        self._fans = CoarseFans(self._triangles, self._known_count)
        self._triangles = self._wedge_vertices[level.triangles]
        self._latest = self._first_wedges + [-1] * added
        self._ranks: dict[int, int] = {}
        self._last_known = self._last_vertex = self._last_wedge = 0
        self._explicit_vertices, self._codes, self._parent_symbols, self._explicit_parents = [], [], [], []
        self._vertex_references, self._wedge_references = [], []
        symbols = level.traversal.symbols.tolist()
        triangle_symbols = np.flatnonzero(level.traversal.symbols != BOUNDARY).tolist()
        corners = level.triangles.ravel().tolist()
        columns = (level.traversal.across.tolist(), level.traversal.third_sources.tolist())
        attached = 0
        for triangle, (across, source) in enumerate(zip(*columns, strict=True)):
            wedges = corners[3 * triangle : 3 * triangle + 3]
            if across < 0:
                self._start(wedges)
                continue
            row = triangle_symbols[attached]
            attached += 1
            first = across - across % 3
            end, start, apex = corners[across], corners[first + (across + 1) % 3], corners[first + (across + 2) % 3]
            codes = self._meet(wedges[0], start), self._meet(wedges[1], end)
            if symbols[row] in (NEW, OTHER):
                symbols[row] = self._attach(wedges, apex, codes == (SAME_WEDGE, SAME_WEDGE))
            else:
                self._meet(wedges[2], corners[source], None if any(codes) else (wedges[0], wedges[1], apex))
        return LevelSymbols(
            symbols=bytes(symbols),
            vertices=encode_integers(self._explicit_vertices),
            wedges=encode_integers(self._codes),
            parent_symbols=bytes(self._parent_symbols),
            parents=encode_integers(self._explicit_parents),
            vertex_references=np.array(self._vertex_references, np.int32).reshape(-1, 3),
            wedge_references=np.array(self._wedge_references, np.int32).reshape(-1, 3),
        )

    def _start(self, wedges: list[int]) -> None:
        """Encode a triangle without an edge at the border."""
        for wedge in wedges:
            vertex = self._vertices[wedge]
            self._write_vertex(vertex)
            if vertex == len(self._first_wedges):
                self._add_vertex(wedge, (self._last_vertex,) * 3, (self._last_wedge,) * 3)
            else:
                self._meet(wedge, self._latest[vertex])
            self._mark_met(vertex)

    def _attach(self, wedges: list[int], apex: int, is_smooth: bool) -> int:
        """Encode the third vertex of a triangle that does not follow from the border. Return the symbol. is_smooth: no seam is crossed."""
        start, end, third, top = (self._vertices[wedge] for wedge in (*wedges, apex))
        references = (wedges[0], wedges[1], apex) if is_smooth else (wedges[1],) * 3
        if third == len(self._first_wedges):
            self._add_vertex(wedges[2], (start, end, top), references)
            self._mark_met(third)
            return NEW
        candidate = -1 if third in self._ranks else self._fans.find_index(third, self._find_families(start, end, top))
        symbol = CANDIDATE + candidate
        if candidate < 0:
            symbol = OTHER
            self._write_vertex(third)
        self._meet(wedges[2], self._latest[third], references)
        self._mark_met(third)
        return symbol

    def _find_families(self, *vertices: int) -> tuple[int, ...]:
        """Return the vertices of coarser levels to which `vertices` belong: themselves or their parents."""
        return tuple(vertex if vertex < self._known_count else self._parents[vertex] for vertex in vertices)

    def _write_vertex(self, vertex: int) -> None:
        """Append the integer of `vertex`: 0 for an added one, odd for one that was met, even for another one of coarser levels."""
        if vertex in self._ranks:
            self._explicit_vertices.append(1 + 2 * (len(self._ranks) - 1 - self._ranks[vertex]))
        elif vertex < self._known_count:
            self._explicit_vertices.append(2 + 2 * encode_signed(vertex - self._last_known))
        else:
            self._explicit_vertices.append(0)

    def _mark_met(self, vertex: int) -> None:
        self._last_vertex = vertex
        if vertex not in self._ranks:
            self._ranks[vertex] = len(self._ranks)
            if vertex < self._known_count:
                self._last_known = vertex

    def _add_vertex(self, wedge: int, references: tuple[int, int, int], wedge_references: tuple[int, int, int]) -> None:
        """Encode an added vertex and its first wedge."""
        vertex = len(self._first_wedges)
        self._first_wedges.append(wedge)
        self._latest[vertex] = self._last_wedge = wedge
        self._wedge_count += 1
        self._vertex_references.append(references)
        self._wedge_references.append(wedge_references)
        if self._known_count:
            families, parent = self._find_families(*references), self._parents[vertex]
            candidate = self._fans.find_index(parent, families)
            self._parent_symbols.append(EXPLICIT_PARENT if candidate < 0 else candidate)
            if candidate < 0:
                self._explicit_parents.append(encode_signed(parent - families[0]))

    def _meet(self, wedge: int, predicted: int, references: tuple[int, int, int] | None = None) -> int:
        """Encode `wedge` of a vertex for which `predicted` is a wedge. Return its code."""
        if wedge == predicted:
            code = SAME_WEDGE
        elif wedge == self._wedge_count:
            code = ADDED_WEDGE
            self._wedge_count += 1
            self._next_wedges[wedge], self._next_wedges[predicted] = self._next_wedges[predicted], wedge
            self._wedge_references.append((self._last_wedge,) * 3 if references is None else references)
        else:
            code, other = OTHER_WEDGE, self._next_wedges[predicted]
            while other != wedge:
                code, other = code + 1, self._next_wedges[other]
        self._codes.append(code)
        self._latest[self._vertices[wedge]] = self._last_wedge = wedge
        return code
