"""The triangles around removed vertices, before and after their collapses.

Collapses are refused for the topology of the surface, folds in space, and flips of texture coordinates.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.collapses import creates_existing_edge, creates_repeated_edge, measure_quality
from ...geometry.proximity import encode_pairs
from .topology import BOUNDARY, Collapses, Topology

VALID, TOPOLOGY, SHORT_CURVE, FOLD, FLIP = range(5)  # why a collapse is refused
MIN_NORMAL_COSINE = 0.2  # between the normals of a triangle before and after a collapse
MIN_FACING_COSINE = 0.0  # between the normal of a triangle and those of the fine mesh at its vertices
MIN_QUALITY = 0.05  # Quality of triangles in space; 1 is equilateral.
MIN_UV_QUALITY = 0.005  # Quality of triangles in texture space.
DEGENERATE_QUALITY = 1e-6  # Triangles in texture space with a lower quality count as having no area.


@dataclass(frozen=True)
class CollapseFans:
    """All corners of removed vertices, in P pairs.

    Attributes:
        topology: of the mesh.
        collapses: N of them.
        owners: (P,) int32, index of the collapse, ascending.
        corners: (P,) int32, halfedges that begin at the removed vertices.
        following, preceding: (P,) int32, the other two vertices of their triangles.
        vanishes: (P,) bool, whether a triangle contains the kept vertex, too.
        wedges: (P,) int32, the wedge that the corner gets, see `replace_wedges`.
    """

    topology: Topology
    collapses: Collapses
    owners: np.ndarray
    corners: np.ndarray
    following: np.ndarray
    preceding: np.ndarray
    vanishes: np.ndarray
    wedges: np.ndarray

    @property
    def triangles(self) -> np.ndarray:
        """(P,) int32 indices of the triangles."""
        return self.corners % self.topology.triangle_count

    @cached_property
    def vanishing_counts(self) -> np.ndarray:
        """(N,) number of triangles that vanish."""
        return np.bincount(self.owners[self.vanishes], minlength=len(self.collapses.removed))

    @cached_property
    def neighbors(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of a collapse and a neighbor of its removed vertex; each neighbor once."""
        is_last = self.topology.twins[self.topology.previous(self.corners)] == BOUNDARY
        return np.concatenate([self.owners, self.owners[is_last]]), np.concatenate([self.following, self.preceding[is_last]])

    @cached_property
    def new_edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of a collapse and the key, see `encode_pairs`, of an edge that it creates at the kept vertex."""
        owners, neighbors = self.neighbors
        collapses = self.collapses
        kept = collapses.kept[owners]
        is_new = neighbors != kept
        for opposite in collapses.opposite:
            is_new &= neighbors != opposite[owners]
        return owners[is_new], encode_pairs(kept[is_new], neighbors[is_new], self.topology.vertex_count)

    @cached_property
    def merged_halfedges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For each triangle that vanishes: the collapse, and the halfedges between its third vertex and the removed and the kept vertex."""
        rows = np.flatnonzero(self.vanishes)
        corners, topology = self.corners[rows], self.topology
        following, preceding = topology.next(corners), topology.previous(corners)
        is_first = self.following[rows] == self.collapses.kept[self.owners[rows]]
        return self.owners[rows], np.where(is_first, preceding, corners), following

    def any_of(self, is_found: np.ndarray) -> np.ndarray:
        """Return for which collapses (N,) bool any pair `is_found` (P,)."""
        found = np.zeros(len(self.collapses.removed), bool)
        found[self.owners[is_found]] = True
        return found


def build_fans(topology: Topology, collapses: Collapses, groups: np.ndarray, attributes: np.ndarray) -> CollapseFans:
    """Return the fans of `collapses`.

    Args:
        groups: (W,) int32 of wedges between which there are no seams. attributes: (W, A).
    """
    owners, corners = topology.find_corners(collapses.removed)
    following = topology.ends[corners]
    preceding = topology.starts[topology.previous(corners)]
    kept = collapses.kept[owners]
    return CollapseFans(
        topology=topology,
        collapses=collapses,
        owners=owners,
        corners=corners,
        following=following,
        preceding=preceding,
        vanishes=(following == kept) | (preceding == kept),
        wedges=replace_wedges(collapses, owners, topology.wedges[corners], groups, attributes),
    )


def replace_wedges(collapses: Collapses, owners: np.ndarray, wedges: np.ndarray, groups: np.ndarray, attributes: np.ndarray) -> np.ndarray:
    """Return the wedges (P,) at the kept vertices of `collapses` that replace `wedges` (P,) of their removed vertices.

    On each side of a seam it is the kept vertex's wedge on that side. Where the two wedges differ only by attributes, inside of a group, it
    is the one whose attributes are closer. A wedge that is on neither side of the edge moves to the kept vertex, with its texture
    coordinates.

    Args:
        owners: (P,) int32 into the collapses. groups, attributes: see `build_fans`.
    """
    first, second = collapses.kept_wedges[:, owners]
    removed_first, removed_second = collapses.removed_wedges[:, owners]
    own_groups = groups[wedges]
    is_first = own_groups == groups[removed_first]
    is_second = (removed_second >= 0) & (own_groups == groups[np.maximum(removed_second, 0)])
    rows = np.flatnonzero(is_first & is_second & (first != second))
    if len(rows):
        distances = [np.abs(attributes[side[rows]] - attributes[wedges[rows]]).sum(axis=1) for side in (first, second)]
        is_first[rows[distances[1] < distances[0]]] = False
    return np.where(is_first, first, np.where(is_second, second, wedges))


def find_compatible(fans: CollapseFans) -> np.ndarray:
    """Return which collapses (N,) bool can be performed together. Of two that cannot, the first is preferred.

    Two collapses that share no triangle may still make the same edge or the same triangle, or close a curve from both sides.
    """
    topology = fans.topology
    is_compatible = ~creates_repeated_edge(*fans.new_edges, len(fans.collapses.removed))
    _drop_mirrored_triangles(fans, is_compatible)
    owners, _, at_kept = fans.merged_halfedges
    vanishing_owner = np.full(topology.triangle_count, -1, np.int32)
    vanishing_owner[at_kept % topology.triangle_count] = owners
    twins = topology.twins[at_kept]
    other = np.where(twins >= 0, vanishing_owner[twins % topology.triangle_count], -1)
    is_compatible[owners[(other >= 0) & (other < owners)]] = False
    return is_compatible


def _drop_mirrored_triangles(fans: CollapseFans, is_compatible: np.ndarray) -> None:
    """Exclude collapses that with earlier ones give two triangles with the same vertices: those on both sides of an edge."""
    topology = fans.topology
    rows = np.flatnonzero(~fans.vanishes)
    opposite = topology.next(fans.corners[rows])
    changed_owner = np.full(len(topology.starts), -1, np.int32)
    changed_owner[opposite] = fans.owners[rows]
    twins = topology.twins[opposite]
    other = np.where(twins >= 0, changed_owner[twins], -1)
    kept = fans.collapses.kept
    owners = fans.owners[rows]
    is_mirrored = (other >= 0) & (other < owners) & (kept[owners] == kept[np.maximum(other, 0)])
    is_compatible[owners[is_mirrored]] = False


@dataclass(frozen=True)
class Surface:
    """What the guards need to know about V vertices and W wedges.

    positions: (3, V) float64. normals: (3, V) float64, unit normals of the fine mesh. uvs: (2, W) float64.
    """

    positions: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray


@dataclass(frozen=True)
class Relaxation:
    """What is allowed in drastic simplification.

    small_size: length of the longest edge up to which a triangle may fold over. drops_islands: whether the last triangle of an island may
    vanish between two others.
    """

    small_size: float = 0.0
    drops_islands: bool = False


def find_refusals(fans: CollapseFans, surface: Surface, orientations: np.ndarray, relaxation: Relaxation) -> np.ndarray:
    """Return why each collapse is refused, (N,) uint8, VALID for those that are not.

    Args:
        orientations: (T,) int8, the sign of the area that each triangle's texture coordinates should have, 0 if it has no area.
    """
    reasons = np.zeros(len(fans.collapses.removed), np.uint8)
    reasons[_folds(fans, surface, relaxation)] = FOLD
    reasons[_flips(fans, surface, orientations)] = FLIP
    if not fans.topology.crosses_seams:
        reasons[_shortens_curve(fans, relaxation)] = SHORT_CURVE
    reasons[_breaks_topology(fans)] = TOPOLOGY
    return reasons


def _breaks_topology(fans: CollapseFans) -> np.ndarray:
    """Return which collapses (N,) bool make an edge that exists (the link condition), give two triangles with the same vertices, or remove
    all triangles."""
    topology, collapses = fans.topology, fans.collapses
    is_broken = creates_existing_edge(*fans.new_edges, topology.edge_keys, len(collapses.removed))
    twins = topology.twins[topology.next(fans.corners)]
    apex = np.where(twins >= 0, topology.ends[topology.next(np.maximum(twins, 0))], -1)
    is_broken |= fans.any_of(~fans.vanishes & (apex == collapses.kept[fans.owners]))
    owners, _, at_kept = fans.merged_halfedges
    is_alone = topology.twins[at_kept] == BOUNDARY  # Nothing remains of an ear.
    counts = np.bincount(fans.owners, minlength=len(collapses.removed))
    is_broken[owners[is_alone & (counts[owners] == 1)]] = True
    return is_broken


def _shortens_curve(fans: CollapseFans, relaxation: Relaxation) -> np.ndarray:
    """Return which collapses (N,) bool remove the last triangle between two curves, or leave a loop of two edges."""
    topology = fans.topology
    owners, at_removed, at_kept = fans.merged_halfedges
    is_curve = topology.is_curve[at_removed] & topology.is_curve[at_kept] & topology.is_curve[fans.collapses.halfedges[owners]]
    if relaxation.drops_islands:
        is_curve &= (topology.twins[at_removed] == BOUNDARY) & (topology.twins[at_kept] == BOUNDARY)
    is_shortened = np.zeros(len(fans.collapses.removed), bool)
    is_shortened[owners[is_curve]] = True
    return is_shortened


def _folds(fans: CollapseFans, surface: Surface, relaxation: Relaxation) -> np.ndarray:
    """Return which collapses (N,) bool turn a triangle by too much, or make a sliver that is worse than the triangles before."""
    rows = np.flatnonzero(~fans.vanishes)
    owners = fans.owners[rows]
    first, second = fans.following[rows], fans.preceding[rows]
    removed, kept = fans.collapses.removed[owners], fans.collapses.kept[owners]
    a, b = surface.positions.take(first, axis=1), surface.positions.take(second, axis=1)
    old_normals, old_squares, _ = _measure(surface.positions.take(removed, axis=1), a, b)
    new_normals, new_squares, new_longest = _measure(surface.positions.take(kept, axis=1), a, b)
    old_lengths, new_lengths = _length(old_normals), _length(new_normals)
    cosines = _dot(old_normals, new_normals)
    is_bad = cosines < MIN_NORMAL_COSINE * old_lengths * new_lengths
    shared = surface.normals.take(first, axis=1) + surface.normals.take(second, axis=1)
    new_facing = _dot(new_normals, shared + surface.normals.take(kept, axis=1))
    old_facing = _dot(old_normals, shared + surface.normals.take(removed, axis=1))
    is_bad |= (new_facing <= MIN_FACING_COSINE * new_lengths) & (old_facing > MIN_FACING_COSINE * old_lengths)
    old_quality, new_quality = measure_quality(old_lengths, old_squares), measure_quality(new_lengths, new_squares)
    is_bad |= new_quality < _worst_before(old_quality, owners, len(fans.collapses.removed), MIN_QUALITY)[owners]
    is_bad &= new_longest > relaxation.small_size**2
    return _mark(owners[is_bad], len(fans.collapses.removed))


def _flips(fans: CollapseFans, surface: Surface, orientations: np.ndarray) -> np.ndarray:
    """Return which collapses (N,) bool change the sign of a triangle's area in texture space, or make that area vanish."""
    rows = np.flatnonzero(~fans.vanishes)
    owners, corners = fans.owners[rows], fans.corners[rows]
    topology = fans.topology
    a = surface.uvs.take(topology.wedges[topology.next(corners)], axis=1)
    b = surface.uvs.take(topology.wedges[topology.previous(corners)], axis=1)
    signs = orientations[fans.triangles[rows]]
    old_quality, new_quality = (
        _uv_quality(surface.uvs.take(wedges, axis=1), a, b) * signs for wedges in (topology.wedges[corners], fans.wedges[rows])
    )
    worst = _worst_before(old_quality, owners, len(fans.collapses.removed), MIN_UV_QUALITY)
    limits = np.maximum(worst, DEGENERATE_QUALITY)[owners]
    limits = np.where(old_quality > DEGENERATE_QUALITY, limits, np.minimum(old_quality, 0.0))  # a triangle without area may remain so
    is_bad = (new_quality < limits) & (signs != 0)
    return _mark(owners[is_bad], len(fans.collapses.removed))


def find_orientations(corner_uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
    """Return the signs (T,) int8 of the areas of `corner_uvs` (T, 3, 2); of triangles without area, that of most triangles of their
    `islands` (T,) int, 0 if there is none."""
    quality = measure_uv_quality(corner_uvs.transpose(1, 0, 2))
    signs = np.sign(quality).astype(np.int8)
    signs[np.abs(quality) <= DEGENERATE_QUALITY] = 0
    sums = np.sign(np.bincount(islands, weights=signs)).astype(np.int8)
    return np.where(signs == 0, sums[islands], signs).astype(np.int8)


def measure_uv_quality(corner_uvs: np.ndarray) -> np.ndarray:
    """Return the signed quality (T,) of triangles `corner_uvs` (3, T, 2): 1 or -1 if equilateral, 0 without area."""
    return _uv_quality(*corner_uvs.transpose(0, 2, 1))


def _measure(apex: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return normals (3, N), twice the area long, sums of squared sides (N,), and the largest squared side (N,)."""
    first, second = a - apex, b - apex
    normals = np.empty_like(first)
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        normals[axis] = first[i] * second[j] - first[j] * second[i]
    sides = [_dot(side, side) for side in (first, second, b - a)]
    return normals, sides[0] + sides[1] + sides[2], np.maximum(np.maximum(sides[0], sides[1]), sides[2])


def _uv_quality(apex: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the signed quality (N,) of triangles in the plane, 1 or -1 if equilateral."""
    first, second = a - apex, b - apex
    squares = sum(_dot(side, side) for side in (first, second, b - a))
    return measure_quality(first[0] * second[1] - first[1] * second[0], squares)


def _worst_before(quality: np.ndarray, owners: np.ndarray, count: int, maximum: float) -> np.ndarray:
    """Return the smallest `quality` (P,) of each of `count` owners (P,), ascending; at most `maximum`."""
    worst = np.full(count, maximum)
    if len(owners):
        first = np.flatnonzero(np.concatenate([[True], owners[1:] != owners[:-1]]))
        worst[owners[first]] = np.minimum(np.minimum.reduceat(quality, first), maximum)
    return worst


def _mark(indices: np.ndarray, count: int) -> np.ndarray:
    marked = np.zeros(count, bool)
    marked[indices] = True
    return marked


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.einsum("in,in->n", first, second)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(_dot(vectors, vectors))
