"""Repair of voxels that would smooth badly (section 3.8 and Figure 13 of the paper)."""

from itertools import combinations

import numpy as np

MARGIN = 1  # voxels around the repaired ones that the repair depends on
MAX_SPIKE_NEIGHBORS = 1  # a solid voxel with no more solid face neighbors is the tip of a spike, which smoothing turns into a needle
MIN_PIT_NEIGHBORS = 5  # an empty voxel with as many solid face neighbors is a pit


def repair_voxels(solid: np.ndarray) -> np.ndarray:
    """Remove spikes, fill pits and join voxels that touch only along an edge.

    Smoothing would leave a bridge of zero width where two voxels touch only along an edge. One of the two empty voxels beside the edge is
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
