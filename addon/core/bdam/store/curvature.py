"""The curvature of the Earth: distant ground is lower by d^2 / 2 R, d the distance from the origin of the local frame.

It is a function of the position alone, so that patches meet as without it. A triangle is straight, and the ground between its corners
bulges by up to L^2 / 8 R, L the size of the triangle; errors of patches count that with the size of the patch.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .structure import Level

EARTH_RADIUS = 6_371_000.0  # meters, the mean radius


def find_drop(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return by how many meters the ground is lower, float64, at local meters `x` and `y` of any shape."""
    return (np.square(x, dtype=np.float64) + np.square(y, dtype=np.float64)) / (2.0 * EARTH_RADIUS)


def find_drop_gradients(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the derivatives (N, 2) float64 of the drop along local x and y at local meters (N,)."""
    return np.stack([x, y], axis=1) / EARTH_RADIUS


def curve_levels(levels: Sequence[Level]) -> list[Level]:
    """Return levels whose bounding boxes and errors hold for curved ground. Those of a patch contain those of its children, as before."""
    curved = []
    for number, level in enumerate(levels):
        low, high = level.low.astype(np.float64), level.high.astype(np.float64)
        nearest = np.maximum(np.maximum(low[:, :2], -high[:, :2]), 0.0)
        farthest = np.maximum(np.abs(low[:, :2]), np.abs(high[:, :2]))
        low[:, 2] -= find_drop(*farthest.T)
        high[:, 2] -= find_drop(*nearest.T)
        errors = level.errors
        if number < len(levels) - 1:  # Leaves have all samples.
            errors = _round_up(errors + np.square(high[:, :2] - low[:, :2]).sum(axis=1) / (8.0 * EARTH_RADIUS))
        curved.append(replace(level, low=-_round_up(-low), high=_round_up(high), errors=errors))
    return curved


def _round_up(values: np.ndarray) -> np.ndarray:
    """Return float32 values that are not smaller."""
    return np.nextafter(values.astype(np.float32), np.float32(np.inf))
