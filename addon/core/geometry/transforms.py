"""Affine transforms, orthonormal frames, origins for single precision, and products of vectors in the plane."""

import numpy as np


def transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return `points` (..., 3) of any floating type, transformed by an affine matrix (4, 4), as float64."""
    matrix = np.asarray(matrix, np.float64)
    return np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def is_invertible(matrix: np.ndarray) -> bool:
    """Return whether a matrix (4, 4) is finite and does not project space to a plane, a line or a point."""
    return bool(np.isfinite(matrix).all() and np.linalg.matrix_rank(matrix[:3, :3]) == 3)


def mean_scale(matrix: np.ndarray) -> np.ndarray:
    """Return the root mean square (...) of the lengths of the axes of affine matrices (..., 4, 4) or (..., 3, 3)."""
    return np.linalg.norm(np.asarray(matrix, np.float64)[..., :3, :3], axis=(-2, -1)) / np.sqrt(3.0)


def normalize(vectors: np.ndarray) -> np.ndarray:
    """Return `vectors` (..., N) with length 1; zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)


def rotations_of_quaternions(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) float64 of unit quaternions (..., 4) in the order w, x, y, z."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions, np.float64), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def is_mirroring(matrix: np.ndarray) -> np.ndarray:
    """Return whether affine matrices (..., 4, 4) or (..., 3, 3) exchange the front and the back of faces; not if they are not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.linalg.det(np.asarray(matrix, np.float64)[..., :3, :3]) < 0.0


def inverse_transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the points (N, 3) float64 that an affine matrix (4, 4) transforms to `points` (N, 3) of any floating type.

    Raises:
        numpy.linalg.LinAlgError: the matrix is singular.
    """
    matrix = np.asarray(matrix, np.float64)
    return np.linalg.solve(matrix[:3, :3], (np.asarray(points, np.float64) - matrix[:3, 3]).T).T


def frames_from_normals(normals: np.ndarray, helpers: np.ndarray | None = None) -> np.ndarray:
    """Return right-handed frames (N, 3, 3) with rows u, v, n for unit `normals` (N, 3).

    helpers: (N, 3) vectors that are not parallel to the normals; u is perpendicular to them. By default the coordinate axis that is most
    perpendicular to the normal.
    """
    if helpers is None:
        helpers = np.eye(3)[np.abs(normals).argmin(axis=1)]
    u = np.cross(helpers, normals)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.stack([u, np.cross(normals, u), normals], axis=1)


def frame_from_normal(normal: np.ndarray) -> np.ndarray:
    """Return a right-handed frame (3, 3) with rows u, v, n for one unit `normal` (3,).

    It is rotated by 180 degrees around the normal relative to `frames_from_normals`.
    """
    u = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(normal, u), normal])


def choose_origin(viewer: np.ndarray, step: float, max_distance: float) -> np.ndarray:
    """Return the position (3,) float64 that single-precision vertices around a viewer at (3,) are relative to.

    It is zero, except along axes on which the viewer is farther than `max_distance` from zero: there it is the multiple of `step` next to
    the viewer.
    """
    return np.where(np.abs(viewer) > max_distance, np.rint(viewer / step) * step, 0.0)


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the 2D cross product (...) of vectors (..., 2): their signed area, positive where the second is to the left of the first."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def signed_areas(corners: np.ndarray) -> np.ndarray:
    """Return the areas (...) of triangles (..., 3, 2), negative for clockwise ones."""
    return 0.5 * cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
