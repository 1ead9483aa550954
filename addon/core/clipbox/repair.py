"""Voxels that would smooth badly, found and mended (section 3.8 and Figure 13 of the paper)."""

from itertools import combinations

import numpy as np

MARGIN = 1  # voxels beyond those that are mended, which the mending looks at
SPIKE = 1  # set neighbours across faces: a set voxel with no more is the tip of a spike, which smoothing draws to a needle
PIT = 5  # an unset voxel with as many is a pit


def repaired(is_set: np.ndarray) -> np.ndarray:
    """The voxels (X, Y, Z) bool but for their outermost layer, with spikes cleared, pits filled, and those that touch along an edge joined.

    Where two voxels touch along an edge only, smoothing would leave a bridge without width; one of the two unset voxels beside the edge is
    set. What becomes of a voxel depends on the 26 about it alone, so parts of a volume are mended as the whole is.
    """
    inner = is_set[1:-1, 1:-1, 1:-1]
    sides = [_shifted(is_set, axis, step) for axis in range(3) for step in (-1, 1)]
    neighbours = sum(side.astype(np.uint8) for side in sides)
    made = (inner & (neighbours > SPIKE)) | (neighbours >= PIT)
    for first, second in combinations(range(3), 2):
        for step in (-1, 1):  # the unset voxel that is set is the lower one along the second axis
            across = _shifted(is_set, first, step) & _shifted(is_set, second, 1)
            made |= ~inner & across & ~_shifted(is_set, first, step, second, 1)
    return made


def _shifted(is_set: np.ndarray, axis: int, step: int, other: int = -1, other_step: int = 0) -> np.ndarray:
    """The voxels that lie `step` along `axis`, and `other_step` along the axis `other`, from the inner ones."""
    offsets = [1, 1, 1]
    offsets[axis] += step
    if other >= 0:
        offsets[other] += other_step
    return is_set[tuple(slice(offset, offset + side - 2) for offset, side in zip(offsets, is_set.shape, strict=True))]
