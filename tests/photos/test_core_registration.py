"""Registration by points: exact pairs give the camera, noisy ones stay near it, and a wrong pair is found."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.lenses import Lens, PhotoCamera
from farfield.addon.core.photos.registration.registration import register, solve_p3p

SIZE = (1600, 1200)
OTHERS = 100  # points that the registration does not know


def random_camera(random, distortion=None):
    """A camera that sees the cube from -1 to 1."""
    focal = 1600.0 * random.uniform(0.6, 2.0)
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    distortion = 0.05 * random.normal() if distortion is None else distortion
    lens = Lens("SIMPLE_RADIAL", SIZE, (focal, focal), (800.0, 600.0), (distortion,))
    return PhotoCamera("a.jpg", lens, rotation, np.array([0.0, 0.0, 2.8 * focal / 1000.0]))


def random_pairs(random, count, distortion=None):
    camera = random_camera(random, distortion)
    points = random.uniform(-1.0, 1.0, (count + OTHERS, 3))
    positions, _, is_valid = camera.project(points)
    assert is_valid.all()
    return camera, points, positions


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_one_of_the_poses_of_three_points_is_that_of_the_camera(seed):
    random = np.random.default_rng(seed)
    camera = random_camera(random)
    points = random.uniform(-1.0, 1.0, (3, 3))
    local = points @ camera.rotation.T + camera.translation
    poses = solve_p3p(points, local / np.linalg.norm(local, axis=1, keepdims=True))
    assert poses
    for pose in poses:
        assert pose[:, :3] @ pose[:, :3].T == pytest.approx(np.eye(3), abs=1e-9) and np.linalg.det(pose[:, :3]) > 0.0
    truth = np.concatenate([camera.rotation, camera.translation[:, None]], axis=1)
    assert min(np.abs(pose - truth).max() for pose in poses) < 1e-3


def test_points_that_are_the_same_to_rounding_have_no_pose():
    points = np.array([[0.0, 0.0, 0.0], [1e-160, 0.0, 0.0], [0.0, 1.0, 0.0]])
    directions = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    for order in ([0, 1, 2], [0, 2, 1], [2, 0, 1]):
        assert solve_p3p(points[order], directions / np.linalg.norm(directions, axis=1, keepdims=True)) == []


@pytest.mark.parametrize(("count", "is_lens_known"), [(4, True), (7, False), pytest.param(12, False, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("is_flat", [False, True])
def test_exact_pairs_give_the_camera(count, is_lens_known, is_flat):
    random = np.random.default_rng(count + is_flat)
    camera = random_camera(random, distortion=0.0)
    points = random.uniform(-1.0, 1.0, (count, 3))
    if is_flat:
        points[:, 2] = 0.2
    found = register("a.jpg", points + [500.0, -80.0, 3.0], camera.project(points)[0], SIZE, camera.lens if is_lens_known else None)
    assert not found.is_wrong.any() and found.mean_error < 1e-3
    others = random.uniform(-1.0, 1.0, (OTHERS, 3))
    distances = np.linalg.norm(found.camera.project(others + [500.0, -80.0, 3.0])[0] - camera.project(others)[0], axis=1)
    assert distances.max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("is_lens_known", [False, True])
def test_six_noisy_pairs_are_enough(is_lens_known):
    """With noise of 1 px per coordinate, the median camera errs by at most 1.5 px elsewhere."""
    random, errors = np.random.default_rng(1), []
    for _ in range(3):
        camera, points, positions = random_pairs(random, 6)
        noisy = positions[:6] + random.normal(size=(6, 2))
        found = register("a.jpg", points[:6], noisy, SIZE, camera.lens if is_lens_known else None)
        errors.append(np.linalg.norm(found.camera.project(points[6:])[0] - positions[6:], axis=1).mean())
    assert np.median(errors) < 1.5, errors


@pytest.mark.slow
@pytest.mark.parametrize(("count", "is_lens_known"), [(7, False), pytest.param(10, False, marks=pytest.mark.exhaustive), (6, True)])
def test_a_wrong_pair_is_found(count, is_lens_known):
    random = np.random.default_rng(2)
    for _ in range(2):
        camera, points, positions = random_pairs(random, count)
        noisy, wrong = positions[:count] + random.normal(size=(count, 2)), random.integers(count)
        angle = random.uniform(0.0, 2.0 * np.pi)
        noisy[wrong] += random.uniform(60.0, 300.0) * np.array([np.cos(angle), np.sin(angle)])
        found = register("a.jpg", points[:count], noisy, SIZE, camera.lens if is_lens_known else None)
        assert np.flatnonzero(found.is_wrong).tolist() == [wrong]
        assert np.linalg.norm(found.residuals[wrong]) > 30.0


@pytest.mark.slow
def test_noise_alone_is_not_wrong():
    random = np.random.default_rng(3)
    for _ in range(2):
        _, points, positions = random_pairs(random, 9)
        assert not register("a.jpg", points[:9], positions[:9] + random.normal(size=(9, 2)), SIZE).is_wrong.any()


def test_bad_pairs_are_one_sentence():
    _, points, positions = random_pairs(np.random.default_rng(4), 8)
    with pytest.raises(GeometryError, match="has 5 of the 6 pairs of points that are needed, or 4 if its lens is known"):
        register("a.jpg", points[:5], positions[:5], SIZE)
    with pytest.raises(GeometryError, match="not finite"):
        register("a.jpg", points[:6] * np.nan, positions[:6], SIZE)
    with pytest.raises(GeometryError, match="lie on one line"):
        register("a.jpg", np.outer(np.arange(6.0), [1.0, 2.0, 3.0]), positions[:6], SIZE)
