"""The cameras of a ring as files describe them, and a check of those that were read."""

from pathlib import PurePosixPath

import numpy as np
import pytest

from photo_scenes import ring

SIZE = (300, 240)
CAMERAS = ring(4)
FLIP = np.diag([1.0, -1.0, -1.0])


def quaternion(rotation):
    """The quaternion (w, x, y, z) of a rotation, by its axis."""
    values, vectors = np.linalg.eig(rotation)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
    antisymmetric = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    angle = np.arctan2(0.5 * axis @ antisymmetric, 0.5 * (np.trace(rotation) - 1.0))
    return (np.cos(0.5 * angle), *(np.sin(0.5 * angle) * axis))


def numbers(values):
    """Numbers as text, with all digits."""
    return " ".join(repr(float(value)) for value in np.ravel(values))


def poses():
    """Matrices (4, 4) from camera space, x to the right and y down, to the world."""
    result = []
    for camera in CAMERAS:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.rotation.T, camera.position
        result.append(matrix)
    return result


def assert_same(found, names=("0.png", "1.png", "2.png", "3.png")):
    """The cameras are those of the ring."""
    assert [PurePosixPath(camera.name).name for camera in found] == list(names)
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (30, 3))
    for camera in found:
        expected = next(each for each in CAMERAS if PurePosixPath(each.name).stem == PurePosixPath(camera.name).stem)
        assert camera.lens.size == SIZE
        assert camera.project(points)[0] == pytest.approx(expected.project(points)[0], abs=1e-6)
