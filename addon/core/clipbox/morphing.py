"""Vertices that go over to the surface of the next coarser level before the border of a box, so that nothing changes when it moves on.

Where densities are those of the coarser level, interpolated, the surface still has twice as many vertices, which lie closer to it than the
flat faces of the coarser level. Each vertex goes to the plane through the coarser vertex at its corner, or through the mean of those
around it, along the normal: on a straight line to such a vertex it would turn triangles over.
"""

import numpy as np

from .meshing import surface_nets
from .meshing.case_table import OCTANTS
from .meshing.surface_nets import CornerVertices
from .toroidal_grid import ToroidalGrid


def morph_vertices(
    corners: np.ndarray, weights: np.ndarray, coarser: ToroidalGrid, offsets: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the offsets and normals of vertices that have gone to the surface of the next coarser level by `weights`.

    Vertices without a coarser one nearby stay.

    Args:
        corners: (V, 3) int64, corner of each vertex. weights: (V,) float32, from 0 to 1. coarser: the voxels of the coarser level.
        offsets: (V, 3) float32, from their corners, in voxels. normals: (V, 3) float32.
    """
    rows = np.flatnonzero(weights)
    if len(rows) == 0:
        return offsets, normals
    targets, target_normals, counts = _find_targets(corners[rows], coarser)
    weights = np.where(counts > 0, weights[rows], np.float32(0.0))[:, None]
    offsets, normals = offsets.copy(), normals.copy()
    distances = ((targets - offsets[rows]) * target_normals).sum(axis=1, keepdims=True)
    offsets[rows] += weights * distances * target_normals
    blended = normals[rows] + weights * (target_normals - normals[rows])
    lengths = np.sqrt((blended**2).sum(axis=1, keepdims=True))
    normals[rows] = np.where(lengths > 0.0, blended / np.maximum(lengths, MIN_LENGTH), normals[rows])
    return offsets, normals


MIN_LENGTH = np.float32(1e-6)  # Of a normal between two opposite ones, which has no direction.


def _find_targets(corners: np.ndarray, coarser: ToroidalGrid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the means of the coarser vertices around `corners` (K, 3): offsets in voxels (K, 3), normals (K, 3), and their counts (K,)."""
    low = corners.min(axis=0) // 2
    shape = (corners.max(axis=0) + 1) // 2 - low + 1
    local = (corners - 2 * low).astype(np.int32)
    # Indices of eight coarser corners, of which some are the same where those of the finer one are even.
    ends = np.stack([local >> 1, (local + 1) >> 1]) * np.array(surface_nets.voxel_strides(tuple(shape.tolist())), np.int32)
    around = np.stack([ends[x, :, 0] + ends[y, :, 1] + ends[z, :, 2] for x, y, z in OCTANTS.tolist()])
    unique, new_rows = surface_nets.compact_indices(around, int(shape.prod()))
    coarser_corners = surface_nets.unravel_indices(unique, tuple(shape.tolist()))
    values = coarser.values_at((low + coarser_corners)[:, None] + OCTANTS - 1).T
    cases = surface_nets.case_indices(surface_nets.is_solid(values))
    rows = np.flatnonzero((cases > 0) & (cases < 255))
    cases, values = cases[rows], values[:, rows]
    all_crossings = CornerVertices(np.arange(len(rows)), np.zeros(len(rows), np.int8), np.zeros(len(rows), np.int64))
    vertices = np.zeros((len(unique), 7), np.float32)  # Offset in finer voxels, normal, and 1 if there is one.
    vertices[rows, :3] = 2 * surface_nets.vertex_offsets(all_crossings, cases, values)
    vertices[rows, 3:6] = surface_nets.corner_normals(values)
    vertices[rows, 6] = 1.0
    total, sides = np.zeros((len(corners), 7), np.float32), np.zeros((len(corners), 3), np.float32)
    for indices, octant in zip(around, OCTANTS, strict=True):
        found = vertices.take(new_rows.take(indices), axis=0)
        total += found
        sides += found[:, 6:] * (2 * octant - 1).astype(np.float32)
    total[:, :3] += sides * (local & 1)  # Where the index of a corner is odd, the coarser ones are one voxel away.
    counts, lengths = total[:, 6], np.sqrt((total[:, 3:6] ** 2).sum(axis=1, keepdims=True))
    return total[:, :3] / np.maximum(counts, np.float32(1.0))[:, None], total[:, 3:6] / np.maximum(lengths, MIN_LENGTH), counts
