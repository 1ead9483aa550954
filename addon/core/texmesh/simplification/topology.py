"""Halfedges of a textured mesh, its curves of seams and boundaries, and the collapses that these allow.

Triangles are stored as (3, T), see `geometry.vertex_rings`. Halfedge T * row + t begins at corner `row` of triangle t and ends at the next
corner. A curve is a chain of seams, or of boundary edges. Meshes are divided at edges with more than two triangles, so that each part is a
surface.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...arrays import concatenate_ranges
from ...geometry.edges import find_edges
from ...geometry.mesh import face_areas_and_normals
from ...geometry.proximity import argsort_pairs, counting_argsort, encode_pairs
from ...geometry.vertex_rings import VertexRings, build_rings
from ..textured_mesh import TexturedMesh, divide_wedges, reverse_triangles

BOUNDARY, AMBIGUOUS = -1, -2  # in place of a twin
PAIRING_PASSES = 3
WEDGE_BONUS = 4.0  # for triangles with equal wedges at the edge, above every difference of the cosines of their angle


@dataclass(frozen=True)
class Collapses:
    """N half-edge collapses.

    Attributes:
        removed: (N,) int32, vertices that move.
        kept: (N,) int32, their neighbors onto which they move.
        halfedges: (N,) int32, between the two.
        is_reversed: (N,) bool, whether the halfedge begins at the kept vertex, which is so only on boundaries.
        removed_wedges, kept_wedges: (2, N) int32, wedges of the two in the one or two triangles at the edge; -1 for none.
        opposite: (2, N) int32, the third vertices of these triangles; -1 for none.
    """

    removed: np.ndarray
    kept: np.ndarray
    halfedges: np.ndarray
    is_reversed: np.ndarray
    removed_wedges: np.ndarray
    kept_wedges: np.ndarray
    opposite: np.ndarray

    def take(self, rows: np.ndarray) -> "Collapses":
        """Return some of the collapses, by their indices."""
        sides = (side[:, rows] for side in (self.removed_wedges, self.kept_wedges, self.opposite))
        return Collapses(self.removed[rows], self.kept[rows], self.halfedges[rows], self.is_reversed[rows], *sides)


@dataclass(frozen=True)
class Topology:
    """Connectivity of T triangles among V vertices.

    Attributes:
        starts, ends, wedges: (3 T,) int32, the vertices of each halfedge, and the wedge at its start.
        twins: (3 T,) int32, the halfedge of the other triangle, BOUNDARY, or AMBIGUOUS at edges whose triangles are no oriented surface.
        is_curve: (3 T,) bool, whether the edge is on a seam or a boundary.
        seam_counts, boundary_counts: (V,) the number of such edges at a vertex.
        is_locked: (V,) bool, vertices that stay.
        is_free_end: (V,) bool, ends of seams that may collapse into islands.
        crosses_seams: whether vertices may leave seams, and corners, crossings and ends of seams may be removed.
        edge_keys: (E,) int64, ascending, from `encode_pairs`.
        rings: the corners around each vertex.
    """

    starts: np.ndarray
    ends: np.ndarray
    wedges: np.ndarray
    twins: np.ndarray
    is_curve: np.ndarray
    seam_counts: np.ndarray
    boundary_counts: np.ndarray
    is_locked: np.ndarray
    is_free_end: np.ndarray
    crosses_seams: bool
    edge_keys: np.ndarray
    rings: VertexRings

    @property
    def vertex_count(self) -> int:
        """The number of vertices, used or not."""
        return len(self.seam_counts)

    @property
    def triangle_count(self) -> int:
        """The number of triangles."""
        return len(self.starts) // 3

    @cached_property
    def is_used(self) -> np.ndarray:
        """(V,) bool, which vertices have triangles."""
        return np.diff(self.rings.starts) > 0

    @cached_property
    def vertex_wedges(self) -> tuple[np.ndarray, np.ndarray]:
        """The wedges of each vertex: (V + 1,) where those of each vertex begin, and the wedges."""
        owners = np.full(int(self.wedges.max(initial=-1)) + 1, -1, np.int32)
        owners[self.wedges] = self.starts
        used = np.flatnonzero(owners >= 0)
        counts = np.bincount(owners[used], minlength=self.vertex_count)
        return np.concatenate([[0], np.cumsum(counts)]), used[counting_argsort(owners[used], self.vertex_count)]

    @cached_property
    def is_on_curve(self) -> np.ndarray:
        """(V,) bool, which vertices have seams or boundaries."""
        return (self.seam_counts > 0) | (self.boundary_counts > 0)

    @cached_property
    def curve_neighbors(self) -> np.ndarray:
        """(2, V) int32, the neighbors of each vertex along its curve, both the same at an end; undefined for other vertices."""
        once = np.flatnonzero(self.is_curve & (self.twins < np.arange(len(self.twins))))
        vertices, others = (np.concatenate(pair) for pair in ((self.starts[once], self.ends[once]), (self.ends[once], self.starts[once])))
        neighbors = np.zeros((2, self.vertex_count), np.int32)
        neighbors[0, vertices], neighbors[1, vertices[::-1]] = others, others[::-1]  # The last of several assignments stays.
        return neighbors

    @cached_property
    def is_removable(self) -> np.ndarray:
        """(V,) bool, which vertices are inside of islands, or on a curve, but no corner or end of it unless it is free."""
        seams, boundaries = self.seam_counts, self.boundary_counts
        is_regular = ((boundaries == 0) & ((seams == 0) | (seams == 2))) | ((boundaries == 2) & (seams == 0))
        if self.crosses_seams:
            is_regular = (boundaries == 0) | (boundaries == 2)
        return self.is_used & (is_regular | self.is_free_end) & ~self.is_locked

    def next(self, halfedges: np.ndarray) -> np.ndarray:
        """Return the halfedges that follow in the same triangles."""
        following = halfedges + np.int32(self.triangle_count)
        return np.where(following >= len(self.starts), following - np.int32(len(self.starts)), following)

    def previous(self, halfedges: np.ndarray) -> np.ndarray:
        """Return the halfedges that precede in the same triangles."""
        preceding = halfedges - np.int32(self.triangle_count)
        return np.where(preceding < 0, preceding + np.int32(len(self.starts)), preceding)

    def find_corners(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs of a position in `vertices` (N,), ascending, and a halfedge that begins there."""
        first = self.rings.starts[vertices]
        counts = self.rings.starts[vertices + 1] - first
        return np.repeat(np.arange(len(vertices), dtype=np.int32), counts), self.rings.corners[concatenate_ranges(first, counts)]

    def find_collapses(self, vertices: np.ndarray, groups: np.ndarray) -> tuple[np.ndarray, Collapses]:
        """Return the collapses of removable `vertices` (N,) that keep to boundaries, and to seams unless they may cross them, and the
        positions of these in `vertices`, ascending.

        groups: (W,) of wedges between which there are no seams.
        """
        owners, corners = self.find_corners(vertices)
        preceding = self.previous(corners)
        is_last = self.twins[preceding] == BOUNDARY
        owners = np.concatenate([owners, owners[is_last]])
        halfedges = np.concatenate([corners, preceding[is_last]])
        is_reversed = np.arange(len(halfedges)) >= len(corners)
        if self.crosses_seams:
            is_allowed = (self.twins[halfedges] == BOUNDARY) | (self.boundary_counts[vertices[owners]] == 0)
        else:
            is_along = self.is_on_curve & ~self.is_free_end
            is_allowed = self.is_curve[halfedges] == is_along[vertices[owners]]
        order = np.flatnonzero(is_allowed)
        order = order[np.argsort(owners[order], kind="stable")]
        owners, halfedges, is_reversed = owners[order], halfedges[order], is_reversed[order]
        collapses = self._find_sides(vertices[owners], halfedges, is_reversed)
        if self.crosses_seams:
            return owners, collapses
        # A vertex with one wedge where two seams meet is the end of both.
        first, second = collapses.removed_wedges
        is_end = (second >= 0) & self.is_curve[halfedges] & (groups[first] == groups[second])
        kept = np.flatnonzero(~is_end)
        return owners[kept], collapses.take(kept)

    def _find_sides(self, removed: np.ndarray, halfedges: np.ndarray, is_reversed: np.ndarray) -> Collapses:
        following, twins = self.next(halfedges), self.twins[halfedges]
        has_twin = twins >= 0
        other = np.where(has_twin, twins, 0)
        after = self.next(other)
        first_wedges, second_wedges = self.wedges[halfedges], self.wedges[following]
        return Collapses(
            removed=removed,
            kept=np.where(is_reversed, self.starts[halfedges], self.ends[halfedges]),
            halfedges=halfedges,
            is_reversed=is_reversed,
            removed_wedges=np.stack(
                [np.where(is_reversed, second_wedges, first_wedges), np.where(has_twin, self.wedges[after], np.int32(-1))]
            ),
            kept_wedges=np.stack(
                [np.where(is_reversed, first_wedges, second_wedges), np.where(has_twin, self.wedges[other], np.int32(-1))]
            ),
            opposite=np.stack([self.ends[following], np.where(has_twin, self.ends[after], np.int32(-1))]),
        )


def build_topology(
    triangles: np.ndarray,
    wedges: np.ndarray,
    groups: np.ndarray,
    is_locked: np.ndarray,
    frees_ends: bool = False,
    crosses_seams: bool = False,
) -> Topology:
    """Return the topology of `triangles` and `wedges` (3, T) int32; there are seams between wedges of different groups (W,).

    Args:
        is_locked: (V,) bool, vertices that are never removed, in addition to those at edges whose triangles are no oriented surface.
        frees_ends: whether ends of seams may collapse. crosses_seams: see `Topology`.
    """
    vertex_count = len(is_locked)
    starts, ends = triangles.reshape(-1), triangles[[1, 2, 0]].reshape(-1)
    flat_wedges, end_wedges = wedges.reshape(-1), wedges[[1, 2, 0]].reshape(-1)
    order = argsort_pairs(starts, ends, vertex_count)
    keys = encode_pairs(starts[order], ends[order], vertex_count)
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    counts = np.diff(np.append(first, len(keys)))
    pairs = first[counts == 2]
    one, other = order[pairs], order[pairs + 1]
    is_oriented = starts[one] != starts[other]
    twins = np.full(len(starts), AMBIGUOUS, np.int32)
    twins[order[first[counts == 1]]] = BOUNDARY
    one, other = one[is_oriented], other[is_oriented]
    twins[one], twins[other] = other, one
    start_groups, end_groups = groups[flat_wedges], groups[end_wedges]
    is_seam = (start_groups[one] != end_groups[other]) | (end_groups[one] != start_groups[other])
    is_curve = twins == BOUNDARY
    is_boundary = is_curve.copy()
    seams = one[is_seam]
    is_curve[seams] = is_curve[other[is_seam]] = True
    is_locked = is_locked.copy()
    at_ambiguous = twins == AMBIGUOUS
    is_locked[starts[at_ambiguous]] = is_locked[ends[at_ambiguous]] = True
    rings = build_rings(triangles, vertex_count)
    seam_counts = _count(starts[seams], ends[seams], vertex_count)
    boundary_counts = _count(starts[is_boundary], ends[is_boundary], vertex_count)
    is_free_end = np.zeros(vertex_count, bool)
    if frees_ends:
        is_free_end = (seam_counts > 0) & (boundary_counts == 0)
        a_group = np.zeros(vertex_count, groups.dtype)
        a_group[starts] = start_groups
        is_free_end[starts[start_groups != a_group[starts]]] = False
    return Topology(
        starts=starts,
        ends=ends,
        wedges=flat_wedges,
        twins=twins,
        is_curve=is_curve,
        seam_counts=seam_counts,
        boundary_counts=boundary_counts,
        is_locked=is_locked,
        is_free_end=is_free_end,
        crosses_seams=crosses_seams,
        edge_keys=keys[first],
        rings=rings,
    )


def _count(starts: np.ndarray, ends: np.ndarray, vertex_count: int) -> np.ndarray:
    return np.bincount(starts, minlength=vertex_count) + np.bincount(ends, minlength=vertex_count)


def find_islands(mesh: TexturedMesh) -> np.ndarray:
    """Return the number (T,) of the UV island of each triangle. Triangles of an island are connected by wedges."""
    return label_connected(mesh.wedge_triangles, len(mesh.uvs))


def label_connected(triangles: np.ndarray, count: int) -> np.ndarray:
    """Return the number (T,) of the connected component of each of `triangles` (T, 3) into `count` vertices or wedges."""
    first, second, third = triangles.T
    ones = np.ones(2 * len(triangles), bool)
    graph = coo_array((ones, (np.concatenate([first, first]), np.concatenate([second, third]))), shape=(count, count))
    labels = connected_components(graph, directed=False)[1][first]
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def orient_alike(triangles: np.ndarray) -> np.ndarray:
    """Return which of `triangles` (T, 3) must be reversed, (T,) bool, so that neighbors have opposite directions along their edges: as few
    as possible. None of those that are connected to a one-sided surface, such as a Moebius strip."""
    count = len(triangles)
    edges = find_edges(triangles)
    first, second = edges.interior_halfedges.T
    first_starts, second_starts = (triangles[halfedges // 3, (halfedges + 1) % 3] for halfedges in (first, second))
    first, second = first // 3, second // 3
    is_alike = first_starts != second_starts
    if is_alike.all():
        return np.zeros(count, bool)
    # Node t stands for triangle t, node t + count for the reversed one.
    ends = np.where(is_alike, second, second + count)
    reversed_ends = np.where(is_alike, second + count, second)
    rows, columns = np.concatenate([first, first + count]), np.concatenate([ends, reversed_ends])
    labels = connected_components(coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(2 * count,) * 2), directed=False)[1]
    own, mirrored = labels[:count], labels[count:]
    components = np.unique(np.minimum(own, mirrored), return_inverse=True)[1].reshape(-1)
    is_reversed = own > mirrored
    is_most = np.bincount(components, is_reversed) > 0.5 * np.bincount(components)
    return (is_reversed != is_most[components]) & (own != mirrored)


@dataclass(frozen=True)
class DividedMesh:
    """A mesh whose triangles are oriented alike, with copies of the vertices at which several surfaces touch, and of their wedges, so that
    each surface has its own.

    Attributes:
        mesh: the mesh.
        is_reversed: (T,) bool, triangles that had the opposite orientation before.
        fine_vertices, fine_wedges: (V,), (W,) int32, those of the mesh before.
        is_touching: (V,) bool, the vertices at edges where surfaces touch.
    """

    mesh: TexturedMesh
    is_reversed: np.ndarray
    fine_vertices: np.ndarray
    fine_wedges: np.ndarray
    is_touching: np.ndarray


def divide_into_surfaces(mesh: TexturedMesh) -> DividedMesh:
    """Divide `mesh` at edges with more than two triangles, or two with the same direction. Triangles of opposite directions stay connected
    that have the same wedges there, or else continue each other with the smallest angle."""
    is_reversed = orient_alike(mesh.triangles)
    if is_reversed.any():
        triangles, wedge_triangles, sources = reverse_triangles(is_reversed, (mesh.triangles, mesh.wedge_triangles, mesh.sources))
        mesh = replace(mesh, triangles=triangles, wedge_triangles=wedge_triangles, sources=sources)
    starts, ends = mesh.triangles.reshape(-1), np.roll(mesh.triangles, -1, axis=1).reshape(-1)
    keys = encode_pairs(starts, ends, len(mesh.vertices))
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.concatenate([[True], keys[order][1:] != keys[order][:-1]]))
    counts = np.diff(np.append(first, len(keys)))
    is_regular = counts == 2
    pairs = np.stack([order[first[is_regular]], order[first[is_regular] + 1]])
    is_oriented = starts[pairs[0]] != starts[pairs[1]]
    is_ambiguous = counts > 2
    is_ambiguous[np.flatnonzero(is_regular)[~is_oriented]] = True
    if not is_ambiguous.any():
        counts = len(mesh.vertices), len(mesh.uvs)
        return DividedMesh(mesh, is_reversed, *(np.arange(count, dtype=np.int32) for count in counts), np.zeros(len(mesh.vertices), bool))
    halfedges = order[concatenate_ranges(first[is_ambiguous], counts[is_ambiguous])]
    touched = np.zeros(len(mesh.vertices), bool)
    touched[starts[halfedges]] = touched[ends[halfedges]] = True
    joined = np.concatenate([pairs[:, is_oriented], _pair(mesh, halfedges, keys[halfedges], starts[halfedges] < ends[halfedges])], axis=1)
    following = joined - joined % 3 + (joined + 1) % 3
    first_corners, second_corners = np.concatenate([joined[0], following[0]]), np.concatenate([following[1], joined[1]])
    graph = coo_array((np.ones(len(first_corners), bool), (first_corners, second_corners)), shape=(len(starts),) * 2)
    labels = connected_components(graph, directed=False)[1]
    _, examples, triangles = np.unique(labels, return_index=True, return_inverse=True)
    sources = starts[examples].astype(np.int32)
    triangles = triangles.reshape(-1, 3).astype(np.int32)
    wedge_triangles, fine_wedges, wedge_vertices = divide_wedges(mesh.wedge_triangles, triangles, len(sources))
    divided = replace(
        mesh,
        vertices=mesh.vertices[sources],
        triangles=triangles,
        wedge_triangles=wedge_triangles,
        wedge_vertices=wedge_vertices.astype(np.int32),
        uvs=mesh.uvs[fine_wedges],
        attributes=mesh.attributes[fine_wedges],
    )
    return DividedMesh(divided, is_reversed, sources, fine_wedges.astype(np.int32), touched[sources])


def _pair(mesh: TexturedMesh, halfedges: np.ndarray, keys: np.ndarray, is_forward: np.ndarray) -> np.ndarray:
    """Return pairs (2, P) of `halfedges` (N,), which begin at their corners, that have the same key (N,) and opposite directions."""
    normals = face_areas_and_normals(mesh.vertices[mesh.triangles])[1]
    flat_wedges, end_wedges = mesh.wedge_triangles.reshape(-1), np.roll(mesh.wedge_triangles, -1, axis=1).reshape(-1)
    result = [np.zeros((2, 0), halfedges.dtype)]
    for _ in range(PAIRING_PASSES):
        forward, backward = np.flatnonzero(is_forward), np.flatnonzero(~is_forward)
        low = np.searchsorted(keys[backward], keys[forward], "left")
        counts = np.searchsorted(keys[backward], keys[forward], "right") - low
        one, other = np.repeat(forward, counts), backward[concatenate_ranges(low, counts)]
        if not len(one):
            break
        a, b = halfedges[one], halfedges[other]
        scores = np.einsum("ij,ij->i", normals[a // 3], normals[b // 3])
        scores += WEDGE_BONUS * ((flat_wedges[a] == end_wedges[b]) & (end_wedges[a] == flat_wedges[b]))
        best = np.full((2, len(halfedges)), -1)
        ascending = np.argsort(scores, kind="stable")
        best[0, one[ascending]], best[1, other[ascending]] = ascending, ascending  # the last assignment stays
        mutual = np.flatnonzero(best[0, one] == best[1, other])
        mutual = np.intersect1d(mutual, best[0])
        result.append(np.stack([a[mutual], b[mutual]]))
        is_left = np.ones(len(halfedges), bool)
        is_left[one[mutual]] = is_left[other[mutual]] = False
        halfedges, keys, is_forward = halfedges[is_left], keys[is_left], is_forward[is_left]
    return np.concatenate(result, axis=1)
