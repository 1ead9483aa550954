"""Orthonormal frames from normals."""

import numpy as np


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
