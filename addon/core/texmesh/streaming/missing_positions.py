"""Estimates of positions whose bytes have not come (section VI of the paper).

The paper estimates a lost vertex from its texel, which came in another packet, and from features before and after it in the queue. Here an
added vertex begins at its parent. Then, some times, each moves to where the affine function from texture coordinates to positions that fits
its neighbors best puts its own texel. After few passes that is several times nearer than the parent (docs/results/texmesh.md).
"""

import numpy as np

from .position_prediction import MAX_VALUE, AffineWeights

PASSES = 5


def estimate_missing_positions(affine: AffineWeights, positions: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """Return estimated positions (N, 3) int64 of the vertices that a level adds.

    Args:
        affine: of all neighbors of the added vertices, those of larger number included. positions: (V, 3) integers, 0 to 65535, of the
            coarser levels. parents: (N,), into those; -1 in the coarsest level.
    """
    added = positions[parents] if len(positions) else np.full((len(parents), 3), (MAX_VALUE + 1) / 2)
    owners = np.repeat(np.arange(len(parents)), np.diff(affine.starts))
    current = np.concatenate([positions, added]).astype(np.float64)
    for _ in range(PASSES):
        columns = [np.bincount(owners, affine.weights * column, len(parents)) for column in current[affine.neighbors].T]
        current[len(positions) :] = np.stack(columns, axis=1)
    return np.clip(np.floor(current[len(positions) :] + 0.5), 0, MAX_VALUE).astype(np.int64)
