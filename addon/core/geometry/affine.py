"""Points under affine transforms, such as the matrix of an object."""

import numpy as np


def transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return `points` (..., 3) of any floating type, transformed by an affine matrix (4, 4), as float64."""
    matrix = np.asarray(matrix, np.float64)
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def inverse_transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the points (N, 3) float64 that an affine matrix (4, 4) transforms to `points` (N, 3) of any floating type.

    Raises:
        numpy.linalg.LinAlgError: the matrix is singular.
    """
    matrix = np.asarray(matrix, np.float64)
    return np.linalg.solve(matrix[:3, :3], (np.asarray(points, np.float64) - matrix[:3, 3]).T).T
