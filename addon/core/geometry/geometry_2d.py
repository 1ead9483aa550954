"""Vectors, triangles and bounding rectangles in the plane."""

import numpy as np


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the 2D cross product (...) of vectors (..., 2): their signed area, positive where the second is to the left of the first."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def signed_areas(corners: np.ndarray) -> np.ndarray:
    """Return the areas (...) of triangles (..., 3, 2), negative for clockwise ones."""
    return 0.5 * cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
