"""Vertices, wedges and triangles of a mesh and its levels in the order in which they are sent, coarse ones first.

Section III.A of the paper: vertices of a coarse level are among those of finer ones, so that a refinement sends a removed vertex V_R, the
vertex V_C onto which it had been collapsed, and its texel.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import GeometryError
from ...texmesh.simplification.levels import Simplification, SubsetLevel
from ...texmesh.textured_mesh import TexturedMesh
from .traversal import Traversal, traverse

MAX_CHAIN = 10_000  # So many collapses between two levels are followed to find the parent of a vertex.


@dataclass(frozen=True)
class OrderedLevel:
    """A level whose vertices and wedges are the first of an `OrderedMesh`.

    Attributes:
        vertex_count, wedge_count: how many of them.
        triangles: (T, 3) int32 into wedges, in ascending order of their materials.
        materials: (T,) int32.
        traversal: of those triangles; corner 3 t + c of the traversal is corner c of triangles[t].
    """

    vertex_count: int
    wedge_count: int
    triangles: np.ndarray
    materials: np.ndarray
    traversal: Traversal


@dataclass(frozen=True)
class OrderedMesh:
    """A mesh of V vertices and W wedges, numbered coarse first, and its levels, the coarsest first.

    Attributes:
        positions: (V, 3) float64.
        uvs: (W, 2) float64, v upwards.
        wedge_vertices: (W,) int32.
        parents: (V,) int32, a vertex of a coarser level, onto which the vertex was collapsed in the end; -1 in the coarsest level.
        vertices: (V,) int32, those of the fine mesh.
        wedges: (W,) int32, those of the fine mesh; wedges that differ in attributes only are one.
        levels: coarsest first.
    """

    positions: np.ndarray
    uvs: np.ndarray
    wedge_vertices: np.ndarray
    parents: np.ndarray
    vertices: np.ndarray
    wedges: np.ndarray
    levels: tuple[OrderedLevel, ...]


def order_mesh(mesh: TexturedMesh, levels: Sequence[SubsetLevel], simplification: Simplification) -> OrderedMesh:
    """Number the vertices and wedges of `mesh` in the order in which they are sent.

    Vertices and wedges that a level adds are numbered in the order in which its triangles meet them.

    Args:
        levels: of `simplification`, coarser than `mesh`, finest first.

    Raises:
        GeometryError: a level has no triangles.
    """
    if not len(mesh.triangles) or any(not len(level.triangles) for level in levels):
        raise GeometryError("A level has no triangles; make levels with more of them.")
    same_wedges, merged = _merge_wedges(mesh)
    numbering = _Numbering(len(mesh.vertices), len(same_wedges), mesh.wedge_vertices[same_wedges])
    ordered, rounds = [], np.full(len(mesh.vertices), len(levels))
    corner_wedges = [*(level.wedge_triangles for level in reversed(levels)), mesh.wedge_triangles]
    materials = [*(level.materials for level in reversed(levels)), mesh.materials]
    for index, (wedge_triangles, level_materials) in enumerate(zip(corner_wedges, materials, strict=True)):
        old_count = len(numbering.vertices)
        ordered.append(numbering.add(merged[wedge_triangles], level_materials))
        rounds[numbering.vertices[old_count:]] = index
    vertices, wedges = np.array(numbering.vertices, np.int32), np.array(numbering.wedges, np.int32)
    ancestors = _find_ancestors(simplification, rounds)
    return OrderedMesh(
        positions=mesh.vertices[vertices],
        uvs=mesh.uvs[same_wedges[wedges]],
        wedge_vertices=numbering.vertex_numbers[mesh.wedge_vertices[same_wedges[wedges]]].astype(np.int32),
        parents=_number_parents(ancestors, numbering.vertex_numbers, vertices, ordered),
        vertices=vertices,
        wedges=same_wedges[wedges].astype(np.int32),
        levels=tuple(ordered),
    )


class _Numbering:
    """Numbers of vertices and wedges, given in the order in which the triangles of coarse and then finer levels meet them."""

    def __init__(self, vertex_count: int, wedge_count: int, wedge_vertices: np.ndarray) -> None:
        self._wedge_vertices = wedge_vertices
        self.vertex_numbers, self._wedge_numbers = np.full(vertex_count, -1), np.full(wedge_count, -1)
        self.vertices: list[int] = []
        self.wedges: list[int] = []

    def add(self, wedge_triangles: np.ndarray, materials: np.ndarray) -> OrderedLevel:
        """Return a level with `wedge_triangles` (T, 3) of the wedges that are given, and their materials (T,)."""
        traversal = traverse(self._wedge_vertices[wedge_triangles], materials)
        corners = (traversal.first_corners - traversal.first_corners % 3)[:, None] + (traversal.first_corners[:, None] + np.arange(3)) % 3
        met_wedges = wedge_triangles.reshape(-1)[corners]
        self._extend(self.wedges, self._wedge_numbers, met_wedges.ravel())
        self._extend(self.vertices, self.vertex_numbers, self._wedge_vertices[met_wedges].ravel())
        return OrderedLevel(
            vertex_count=len(self.vertices),
            wedge_count=len(self.wedges),
            triangles=self._wedge_numbers[met_wedges].astype(np.int32),
            materials=materials[traversal.first_corners // 3].astype(np.int32),
            traversal=_renumber_corners(traversal, corners),
        )

    @staticmethod
    def _extend(found: list[int], numbers: np.ndarray, met: np.ndarray) -> None:
        """Number those of `met` that have no number in the order in which they are met first."""
        values, first = np.unique(met, return_index=True)
        added = values[numbers[values] < 0][np.argsort(first[numbers[values] < 0])]
        numbers[added] = len(found) + np.arange(len(added))
        found.extend(added.tolist())


def _renumber_corners(traversal: Traversal, corners: np.ndarray) -> Traversal:
    """Return `traversal` with the corners of the triangles in its order. corners: (T, 3), the ones before."""
    new_corners = np.empty(corners.size + 1, np.int64)
    new_corners[corners.ravel()] = np.arange(corners.size)
    new_corners[-1] = -1  # the last item, for -1
    columns = (traversal.first_corners, traversal.across, traversal.third_sources)
    return Traversal(*(new_corners[column] for column in columns), traversal.symbols)


def _merge_wedges(mesh: TexturedMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return one wedge (U,) for each vertex and texture coordinate, and for each wedge (W,) the index of that."""
    keys = np.column_stack([mesh.wedge_vertices.astype(np.float64), mesh.uvs + 0.0])  # + 0.0 makes -0.0 equal to 0.0
    _, examples, merged = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return examples, merged.reshape(-1)


def _find_ancestors(simplification: Simplification, rounds: np.ndarray) -> np.ndarray:
    """Return for each vertex (V,) that onto which it was collapsed in the end, of those that a coarser level has; -1 if there is none.

    rounds: (V,) index of the coarsest level that has the vertex.
    """
    targets = np.full(len(rounds), -1)
    targets[simplification.removed] = simplification.kept  # The last of several collapses of copies of a vertex counts.
    ancestors = targets.copy()
    rows = np.arange(len(rounds))
    for _ in range(MAX_CHAIN):
        rows = rows[(ancestors[rows] >= 0) & (rounds[ancestors[rows]] >= rounds[rows])]
        if not len(rows):
            break
        ancestors[rows] = targets[ancestors[rows]]
    ancestors[rows] = -1  # copies of vertices may have been collapsed onto each other
    return ancestors


def _number_parents(ancestors: np.ndarray, vertex_numbers: np.ndarray, vertices: np.ndarray, levels: Sequence[OrderedLevel]) -> np.ndarray:
    """Return the parents (V,) int32. A vertex that vanished without a collapse has vertex 0."""
    parents = np.where(ancestors[vertices] >= 0, vertex_numbers[ancestors[vertices]], 0)
    parents[: levels[0].vertex_count] = -1
    return parents.astype(np.int32)
