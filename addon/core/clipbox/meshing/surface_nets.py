"""Manifold surface nets: one quad per face between a solid and an empty voxel, with vertices shared by lattice corner.

The vertices of a corner depend only on the eight voxels around it (see `case_table`), in a fixed order of summation. Any part of a volume
therefore gives exactly the same vertices as the whole. Corners have flat indices like voxels: corner (i, j, k) is the low corner of voxel
(i, j, k). After section 3.4 of the paper; surface nets after Gibson, Constrained Elastic Surface Nets, 1998. Voxels that would smooth badly
are repaired before (section 3.8 and Figure 13).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from ...arrays import concatenate_ranges
from .case_table import AXES, HIGH, LOW, OCTANTS, PAIR_AXIS, case_table, pair_index

OCTANT_CENTERS = (OCTANTS - 0.5).astype(np.float32)  # (8, 3) relative to the corner, in voxels
# Corners of a face, for normals down and up the axis: bit 0 is 1 on the high side of the next axis, bit 1 on that of the axis after it.
FACE_CORNERS = np.array([(0, 2, 3, 1), (0, 1, 3, 2)])
_FACE_PAIRS = [  # per axis, the pair of octants of each corner of a face that lie on both sides of the face
    np.array(
        [
            [pair_index(axis, ((corner & 1 ^ 1) << (axis + 1) % 3) + ((corner >> 1 ^ 1) << (axis + 2) % 3)) for corner in corners]
            for corners in FACE_CORNERS
        ],
        np.int8,
    )
    for axis in range(AXES)
]
_PAIR_CENTERS = np.array([np.where(axis == PAIR_AXIS, 0.0, OCTANT_CENTERS[LOW, axis]) for axis in range(AXES)], np.float32)  # (3, 12)
REPAIR_MARGIN = 1  # voxels around the repaired ones that the repair depends on
MAX_SPIKE_NEIGHBORS = 1  # a solid voxel with no more solid face neighbors is the tip of a spike, which smoothing turns into a needle
MIN_PIT_NEIGHBORS = 5  # an empty voxel with as many solid face neighbors is a pit


@dataclass(frozen=True)
class Faces:
    """Faces between solid and empty voxels.

    Attributes:
        corners: (F, 4) int64, flat corner indices, counter-clockwise as seen from the empty voxel.
        pairs: (F, 4) int8, pair of octants of each corner that the face lies between.
        voxels: (F,) int64, the owned voxel at the face, the lower one where both are owned.
    """

    corners: np.ndarray
    pairs: np.ndarray
    voxels: np.ndarray


@dataclass(frozen=True)
class CornerVertices:
    """The vertices of corners, one per cycle.

    corners (V,) int64: row of the corner of each vertex. cycles (V,) int8. Vertex i is the first vertex of corner i. `extra_start` (K,) is
    the index of a corner's second vertex, 0 where there is none; the others follow it.
    """

    corners: np.ndarray
    cycles: np.ndarray
    extra_start: np.ndarray


@lru_cache(maxsize=8)
def interior_mask(shape: tuple[int, int, int]) -> np.ndarray:
    """Return a flat mask of all voxels of an array except its outermost layer."""
    interior = np.zeros(shape, bool)
    interior[1:-1, 1:-1, 1:-1] = True
    interior.flags.writeable = False
    return interior.ravel()


def is_solid(values: np.ndarray) -> np.ndarray:
    """Return a mask of the voxels with positive values."""
    return values.view(np.int16) > 0 if values.dtype == np.float16 else values > 0  # much faster than comparing half floats


def have_one_sign(*windows: np.ndarray) -> bool:
    """Return whether all voxels of all `windows` are solid, or all are empty."""
    masks = [is_solid(window) for window in windows]
    return all(mask.all() for mask in masks) or not any(mask.any() for mask in masks)


def unravel_indices(indices: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Return the coordinates (K, 3) int32 of voxels or corners with flat `indices` (K,) in an array."""
    remainder, coordinates = indices.astype(np.int32), np.empty((len(indices), AXES), np.int32)
    for axis in (2, 1):
        quotient = remainder // np.int32(shape[axis])
        coordinates[:, axis] = remainder - quotient * np.int32(shape[axis])
        remainder = quotient
    coordinates[:, 0] = remainder
    return coordinates


def voxel_strides(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return the steps in flat voxel indices along each axis."""
    return shape[1] * shape[2], shape[2], 1


def find_faces(solid: np.ndarray, owned: np.ndarray, above: np.ndarray | None = None, below: np.ndarray | None = None) -> Faces:
    """Find the faces between `owned` voxels and their neighbors along each axis.

    Args:
        solid: (X, Y, Z) bool. owned: (X * Y * Z,) bool, none of them in the outermost layer. above, below: (X * Y * Z,) bool, voxels that
            count as neighbors where they lie above owned ones, and below them. By default all count above and none below.
    """
    flat, strides = solid.ravel(), voxel_strides(solid.shape)
    corners, pairs, voxels = [], [], []
    for axis in range(AXES):
        step, second, third = (strides[(axis + offset) % AXES] for offset in range(AXES))
        is_face = flat[:-step] != flat[step:]
        is_face &= owned[:-step] if above is None else (owned[:-step] & above[step:]) | (below[:-step] & owned[step:])
        low = fast_flatnonzero(is_face)
        points_up = flat[low].astype(np.int64)
        corner_steps = step + (FACE_CORNERS & 1) * second + (FACE_CORNERS >> 1) * third
        face_corners = corner_steps.take(points_up, axis=0)  # much faster than corner_steps[points_up]
        face_corners += low[:, None]
        corners.append(face_corners)
        pairs.append(_FACE_PAIRS[axis].take(points_up, axis=0))
        voxels.append(low if above is None else np.where(owned[low], low, low + step))
    return Faces(np.concatenate(corners), np.concatenate(pairs), np.concatenate(voxels))


def fast_flatnonzero(mask: np.ndarray) -> np.ndarray:
    """Return `np.flatnonzero` of a flat mask. Faster where few elements are set: it tests eight at a time."""
    aligned_size = len(mask) // 8 * 8
    words = mask[:aligned_size].view(np.uint64)
    nonzero_words = np.flatnonzero(words != 0)
    within_words = np.flatnonzero(words[nonzero_words].view(bool))
    indices = nonzero_words[within_words >> 3] * 8 + (within_words & 7)
    return np.concatenate([indices, aligned_size + np.flatnonzero(mask[aligned_size:])]) if aligned_size < len(mask) else indices


def compact_indices(corners: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the unique `corners` (K,), ascending, and for each of `size` corners its row among them, undefined for others."""
    is_used = np.zeros(size, bool)
    is_used[corners.ravel()] = True
    unique = fast_flatnonzero(is_used)
    rows = np.empty(size, np.int32)
    rows[unique] = np.arange(len(unique), dtype=np.int32)
    return unique, rows


def gather_octants(voxels: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the values (8, K) of `voxels` (X, Y, Z) around `corners` (K,), none of which lies on a low side of the array."""
    flat = voxels.ravel()
    steps = (OCTANTS - 1) @ np.array(voxel_strides(voxels.shape))
    values = np.empty((8, len(corners)), voxels.dtype)
    for octant, step in enumerate(steps):
        np.take(flat, corners + step, out=values[octant], mode="clip")
    return values


def case_indices(solid: np.ndarray) -> np.ndarray:
    """Return the cases (K,) int64 of octants (8, K) bool."""
    cases = solid[0].astype(np.uint8)
    for octant in range(1, 8):
        cases |= solid[octant].view(np.uint8) << np.uint8(octant)
    return cases.astype(np.int64)


def resolve_non_manifold_edges(cases: np.ndarray, gather_neighbors: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """Return `cases` (K,) with 256 added where the cases at both ends of an edge would make it non-manifold.

    gather_neighbors: returns the cases at the other ends of the edges that leave the corners `rows` (R,) in `directions` (R,).
    """
    non_manifold = case_table().non_manifold
    rows = np.flatnonzero(non_manifold[cases] >= 0)
    if len(rows) == 0:
        return cases
    directions = non_manifold[cases[rows]]
    cases = cases.copy()
    cases[rows] += 256 * (non_manifold[gather_neighbors(rows, directions)] == directions ^ 1)
    return cases


def find_corner_vertices(cases: np.ndarray) -> CornerVertices:
    """Return the vertices of corners with the given `cases` (K,)."""
    cycle_counts = case_table().cycle_counts[cases]
    with_extra = np.flatnonzero(cycle_counts > 1)
    extra_counts = cycle_counts[with_extra] - 1
    extra_start = np.zeros(len(cases), np.int64)
    extra_start[with_extra] = len(cases) + np.cumsum(extra_counts) - extra_counts
    extra_corners = np.repeat(with_extra, extra_counts)
    cycles = np.concatenate([np.zeros(len(cases), np.int8), concatenate_ranges(1, extra_counts).astype(np.int8)])
    return CornerVertices(np.concatenate([np.arange(len(cases)), extra_corners]), cycles, extra_start)


def face_vertices(corner_vertices: CornerVertices, cases: np.ndarray, corners: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return the vertices (F, 4) int32 of faces, given the rows (F, 4) of their `corners`, which are overwritten, and their `pairs`."""
    vertices = corners.ravel()
    with_extra = np.flatnonzero((corner_vertices.extra_start > 0).take(vertices))
    rows = vertices[with_extra]
    cycles = case_table().cycles[cases[rows], pairs.ravel()[with_extra]].astype(np.int64)
    vertices[with_extra] = np.where(cycles > 0, corner_vertices.extra_start[rows] + cycles - 1, rows)
    return vertices.reshape(corners.shape)


def vertex_offsets(
    corner_vertices: CornerVertices, cases: np.ndarray, values: np.ndarray, centers: np.ndarray = OCTANT_CENTERS
) -> np.ndarray:
    """Return vertex positions relative to their corners, (V, 3) float32 in voxels: the means of the zero crossings of their cycles.

    Args:
        cases: (K,). values: (8, K) densities of the octants. centers: positions of the octants' centers relative to the corner, in voxels:
            (8, 3), or (8, 3, K) where they differ.
    """
    values = values.astype(np.float32)
    offsets = np.empty((AXES, len(corner_vertices.corners)), np.float32)
    offsets[:, : len(cases)] = _mean_crossings(values, centers, None)
    vertices = np.concatenate([np.flatnonzero(corner_vertices.extra_start), np.arange(len(cases), len(corner_vertices.corners))])
    if len(vertices):
        rows = corner_vertices.corners[vertices]
        in_cycle = (case_table().cycles[cases[rows]] == corner_vertices.cycles[vertices][:, None]).T
        offsets[:, vertices] = _mean_crossings(values[:, rows], centers if centers.ndim == 2 else centers[:, :, rows], in_cycle)
    return offsets.T


def _mean_crossings(values: np.ndarray, centers: np.ndarray, in_cycle: np.ndarray | None) -> np.ndarray:
    """Return the mean (3, K) of the zero crossings between pairs of octants, over all pairs or over those `in_cycle` (12, K)."""
    low, high = values[LOW], values[HIGH]
    is_crossed = (low > 0) != (high > 0) if in_cycle is None else in_cycle
    t = low / np.where(is_crossed, low - high, np.float32(1.0))  # a masked division takes five times as long
    t *= is_crossed
    if centers.ndim == 3:
        points = centers[LOW] + t[:, None] * (centers[HIGH] - centers[LOW])
        total = np.where(is_crossed[:, None], points, np.float32(0.0)).sum(axis=0)
    else:
        weights = is_crossed.astype(np.float32)
        t -= np.float32(0.5) * weights
        total = t.reshape(AXES, 4, -1).sum(axis=1) + _PAIR_CENTERS @ weights  # sums of halves are exact in any order
    return total / is_crossed.sum(axis=0, dtype=np.float32)


def corner_normals(values: np.ndarray, centers: np.ndarray = OCTANT_CENTERS) -> np.ndarray:
    """Return unit normals (K, 3) float32 along the negative density gradient of octants (8, K), with `centers` as in `vertex_offsets`."""
    values = values.astype(np.float32)
    normals = (values[LOW] - values[HIGH]).reshape(AXES, 4, -1).sum(axis=1) if centers.ndim == 2 else -_fit_gradients(values, centers)
    lengths = np.sqrt((normals**2).sum(axis=0))
    is_zero = lengths == 0
    normals[2, is_zero] = lengths[is_zero] = 1.0
    return (normals / lengths).T


def _fit_gradients(values: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Return the least-squares gradients (3, K) of densities (8, K) at `centers` (8, 3, K)."""
    offsets, differences = centers - centers.mean(axis=0), values - values.mean(axis=0)
    normal_matrix = np.stack([[(offsets[:, row] * offsets[:, column]).sum(axis=0) for column in range(AXES)] for row in range(AXES)])
    rhs = np.stack([(offsets[:, row] * differences).sum(axis=0) for row in range(AXES)])
    return np.linalg.solve(normal_matrix.transpose(2, 0, 1), rhs.T[:, :, None])[:, :, 0].T


def repair_voxels(solid: np.ndarray) -> np.ndarray:
    """Remove spikes, fill pits and join voxels that touch only along an edge.

    Smoothing would leave a bridge of zero width where two voxels touch only along an edge. One of the two empty voxels at the edge is
    filled instead. The result of a voxel depends only on its 26 neighbors, so parts of a volume are repaired like the whole.

    Takes voxels (X, Y, Z) bool. Returns all but the outermost layer, (X - 2, Y - 2, Z - 2) bool.
    """
    inner = solid[1:-1, 1:-1, 1:-1]
    face_neighbors = [_shift(solid, axis, step) for axis in range(3) for step in (-1, 1)]
    neighbor_counts = sum(neighbor.astype(np.uint8) for neighbor in face_neighbors)
    repaired = (inner & (neighbor_counts > MAX_SPIKE_NEIGHBORS)) | (neighbor_counts >= MIN_PIT_NEIGHBORS)
    for first, second in combinations(range(3), 2):
        for step in (-1, 1):  # the empty voxel that is filled is the lower one along the second axis
            diagonal = _shift(solid, first, step) & _shift(solid, second, 1)
            repaired |= ~inner & diagonal & ~_shift(solid, first, step, second, 1)
    return repaired


def _shift(solid: np.ndarray, axis: int, step: int, second_axis: int = -1, second_step: int = 0) -> np.ndarray:
    """Return the neighbors of the inner voxels at `step` along `axis` and `second_step` along `second_axis`."""
    offsets = [1, 1, 1]
    offsets[axis] += step
    if second_axis >= 0:
        offsets[second_axis] += second_step
    return solid[tuple(slice(offset, offset + count - 2) for offset, count in zip(offsets, solid.shape, strict=True))]
