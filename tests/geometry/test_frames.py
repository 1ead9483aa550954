"""Frames from normals are right-handed and orthonormal, with the normal as their last row."""

import numpy as np

from farfield.addon.core.geometry.directions import fibonacci_sphere
from farfield.addon.core.geometry.transforms import frame_from_normal, frames_from_normals

NORMALS = np.concatenate([fibonacci_sphere(100), np.eye(3), -np.eye(3)])


def assert_frames(frames: np.ndarray) -> None:
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    np.testing.assert_array_equal(frames[:, 2], NORMALS)


def test_frames_are_right_handed_and_orthonormal():
    assert_frames(frames_from_normals(NORMALS))
    assert_frames(np.stack([frame_from_normal(normal) for normal in NORMALS]))


def test_single_frames_are_rotated_by_180_degrees():
    for normal, frame in zip(NORMALS, frames_from_normals(NORMALS), strict=True):
        np.testing.assert_allclose(frame_from_normal(normal), frame * [[-1.0], [-1.0], [1.0]], atol=1e-12)


def test_u_is_perpendicular_to_the_helpers():
    helpers = np.roll(NORMALS, 7, axis=0)
    frames = frames_from_normals(NORMALS, helpers)
    assert_frames(frames)
    np.testing.assert_allclose(np.einsum("ni,ni->n", frames[:, 0], helpers), 0.0, atol=1e-12)
