"""Vectors and triangles in the plane."""

import numpy as np


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The areas (...) that vectors (..., 2) span, above 0 where the second one is to the left of the first."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def signed_areas(corners: np.ndarray) -> np.ndarray:
    """Areas (T,) of triangles (T, 3, 2), below 0 where they are clockwise."""
    return 0.5 * cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
