"""Rotations of cameras in files."""

from pathlib import Path

import numpy as np

from ...errors import FileError

MIN_LENGTH = 1e-6  # of a quaternion
MAX_ERROR = 1e-3  # of the products of axes


def is_rotation(matrix: np.ndarray) -> bool:
    """Return whether a matrix is (3, 3) and its rows are perpendicular unit vectors."""
    return matrix.shape == (3, 3) and np.allclose(matrix @ matrix.T, np.eye(3), atol=MAX_ERROR)


def rotation_of_quaternion(quaternion: tuple[float, ...], path: Path) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z), which is normalized.

    Raises:
        FileError: the quaternion has no length; the message names `path`.
    """
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite(length) or length < MIN_LENGTH:
        raise FileError(f'An image in "{path}" has no rotation; export the cameras again.')
    w, x, y, z = np.array(quaternion, np.float64) / length
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
