"""Where a viewer can stand: not inside the ground, nor against a wall."""

import numpy as np

from .terrains.generators import Sampler
from .terrains.grids import Grid

STEP = 4.0  # voxels between two samples
RADIUS = 3  # samples of air in all directions
MAX_RISE = 256  # samples


def find_clearing(sampler: Sampler, position: np.ndarray, voxel_size: float) -> np.ndarray:
    """Return the lowest position (3,) float64 at or above `position`, scene units, with 12 voxels of air in all directions; `position`
    itself if there is none within 1,024 voxels.

    Raises:
        GeometryError: the density function fails.
    """
    step = STEP * voxel_size
    first = np.floor(position / step).astype(np.int64) - RADIUS
    side, height = 2 * RADIUS + 1, MAX_RISE + 2 * RADIUS
    solid = sampler.signs(Grid(tuple(first.tolist()), (side, side, height), step), repair=False) > 0
    counts = np.concatenate([[0], np.cumsum(solid.any(axis=(0, 1)))])
    is_clear = counts[side:] == counts[:-side]
    rise = int(is_clear.argmax()) if is_clear.any() else 0
    return position + [0.0, 0.0, rise * step]
