"""Vertices that go over to the surface of the next coarser level before the border of a box, so that nothing changes when it moves on.

Where densities are those of the coarser level, interpolated, the surface still has twice as many vertices, which lie closer to it than the
flat faces of the coarser level. Each vertex goes to the coarser vertex at its corner, or to the mean of those around it.
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
    offsets[rows] += weights * (targets - offsets[rows])
    blended = normals[rows] + weights * (target_normals - normals[rows])
    lengths = np.sqrt((blended**2).sum(axis=1, keepdims=True))
    normals[rows] = np.where(lengths > 0.0, blended / np.maximum(lengths, MIN_LENGTH), normals[rows])
    return offsets, normals


MIN_LENGTH = np.float32(1e-6)  # Of a normal between two opposite ones, which has no direction.


def _find_targets(corners: np.ndarray, coarser: ToroidalGrid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the means of the coarser vertices around `corners` (K, 3): offsets in voxels (K, 3), normals (K, 3), and their counts (K,)."""
    low = corners.min(axis=0) // 2
    shape = (corners.max(axis=0) + 1) // 2 - low + 1
    strides = np.array(surface_nets.voxel_strides(tuple(shape.tolist())))
    around = (corners[:, None] + OCTANTS) // 2  # Eight coarser corners, of which some are the same where indices are even.
    unique, new_rows = surface_nets.compact_indices((around - low) @ strides, int(shape.prod()))
    coarser_corners = low + surface_nets.unravel_indices(unique, tuple(shape.tolist()))
    values = coarser.values_at(coarser_corners[:, None] + OCTANTS - 1).T
    cases = surface_nets.case_indices(surface_nets.is_solid(values))
    has_vertex = (cases > 0) & (cases < 255)
    unique_offsets, unique_normals = np.zeros((len(unique), 3), np.float32), np.zeros((len(unique), 3), np.float32)
    cases, values = cases[has_vertex], values[:, has_vertex]
    all_crossings = CornerVertices(np.arange(len(cases)), np.zeros(len(cases), np.int8), np.zeros(len(cases), np.int64))
    unique_offsets[has_vertex] = surface_nets.vertex_offsets(all_crossings, cases, values)
    unique_normals[has_vertex] = surface_nets.corner_normals(values)
    offsets, normals, counts = (np.zeros((len(corners), 3), np.float32) for _ in range(3))
    for octant in range(8):
        rows = new_rows.take((around[:, octant] - low) @ strides)
        is_found = has_vertex[rows][:, None]
        offsets += is_found * (2 * unique_offsets[rows] + (2 * around[:, octant] - corners).astype(np.float32))
        normals += unique_normals[rows]
        counts += is_found
    counts = counts[:, 0]
    offsets /= np.maximum(counts, np.float32(1.0))[:, None]
    lengths = np.sqrt((normals**2).sum(axis=1, keepdims=True))
    return offsets, normals / np.maximum(lengths, MIN_LENGTH), counts
