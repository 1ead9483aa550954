"""Tests that refuse collapses: for the topology of the surface, folds in space, and flips of texture coordinates."""

from dataclasses import dataclass

import numpy as np

from ...geometry.collapses import creates_existing_edge, measure_quality
from .collapse_fans import CollapseFans
from .topology import BOUNDARY

VALID, TOPOLOGY, SHORT_CURVE, FOLD, FLIP = range(5)  # why a collapse is refused
MIN_NORMAL_COSINE = 0.2  # between the normals of a triangle before and after a collapse
MIN_FACING_COSINE = 0.0  # between the normal of a triangle and those of the fine mesh at its vertices
MIN_QUALITY = 0.05  # of triangles in space; 1 is equilateral
MIN_UV_QUALITY = 0.005  # of triangles in texture space
DEGENERATE_QUALITY = 1e-6  # of triangles in texture space that count as having no area


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
    is_alone = topology.twins[at_kept] == BOUNDARY  # of an ear, nothing remains
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
