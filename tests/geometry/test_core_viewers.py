"""A viewer sees what its projection shows, and lengths cover the pixels that it says."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.viewers import (
    FULL_SPHERE,
    Projection,
    Viewer,
    camera_window,
    projection_from_matrix,
)

SEEDS = st.integers(0, 2**32 - 1)
KINDS = st.sampled_from(["perspective", "orthographic"])


def random_projection(kind, random):
    left, bottom = random.uniform(-2.0, 0.5, 2)
    width, height, near = random.uniform(0.1, 3.0, 3)
    size = tuple(random.integers(1, 4000, 2).tolist())
    return Projection(kind, (left, left + width, bottom, bottom + height), size, near, near + random.uniform(0.5, 1e4))


def random_viewer(kind, random):
    """A viewer anywhere in a space that may be scaled and sheared."""
    matrix = np.eye(4)
    matrix[:3, :3] = random.normal(size=(3, 3)) + 3.0 * np.eye(3)
    matrix[:3, 3] = random.normal(size=3) * 1e4
    return Viewer(matrix, random_projection(kind, random))


def random_positions(viewer, random):
    """Positions inside and outside of the frustum."""
    left, right, bottom, top = viewer.projection.window
    depths = random.uniform(-0.2, 1.3, 200) * viewer.projection.far
    window = random.uniform([left - 1.0, bottom - 1.0], [right + 1.0, top + 1.0], (200, 2))
    plane = window * depths[:, None] if viewer.projection.kind == "perspective" else window
    camera = np.column_stack([plane, -depths, np.ones(200)])
    return (camera @ viewer.matrix.T)[:, :3]


def clip_coordinates(viewer, positions):
    return np.column_stack([positions, np.ones(len(positions))]) @ (viewer.projection.matrix @ np.linalg.inv(viewer.matrix)).T


@settings(max_examples=30)
@given(kind=KINDS, seed=SEEDS)
def test_positions_are_inside_of_the_planes_where_the_matrix_shows_them(kind, seed):
    random = np.random.default_rng(seed)
    viewer = random_viewer(kind, random)
    positions = random_positions(viewer, random)
    planes = viewer.frustum_planes()
    assert planes.shape == (6, 4) and np.allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
    distances = positions @ planes[:, :3].T + planes[:, 3]
    clip = clip_coordinates(viewer, positions)
    is_shown = (np.abs(clip[:, :3]) <= clip[:, 3:]).all(axis=1)
    is_clear = (np.abs(distances) > 1e-5 * viewer.projection.far).all(axis=1)
    assert ((distances >= 0.0).all(axis=1) == is_shown)[is_clear].all()


@settings(max_examples=30)
@given(kind=KINDS, seed=SEEDS)
def test_pixels_are_those_of_the_matrix(kind, seed):
    random = np.random.default_rng(seed)
    viewer = random_viewer(kind, random)
    positions = random_positions(viewer, random)
    pixels, depths = viewer.project(positions)
    clip = clip_coordinates(viewer, positions)
    is_in_front = depths > 1e-3 * viewer.projection.far
    expected = (clip[:, :2] / clip[:, 3:] + 1.0) / 2.0 * viewer.projection.size
    assert np.allclose(pixels[is_in_front], expected[is_in_front], rtol=1e-5, atol=1e-3)


@settings(max_examples=30)
@given(kind=KINDS, seed=SEEDS)
def test_a_projection_is_recovered_from_its_matrix(kind, seed):
    projection = random_projection(kind, np.random.default_rng(seed))
    found = projection_from_matrix(projection.matrix, projection.size, projection.near, projection.far)
    assert found.kind == kind and np.allclose(found.window, projection.window, atol=1e-9)
    assert np.allclose([found.near, found.far], [projection.near, projection.far], rtol=1e-6)


@settings(max_examples=30)
@given(kind=KINDS, seed=SEEDS)
def test_another_space_changes_nothing_in_the_image(kind, seed):
    random = np.random.default_rng(seed)
    viewer = random_viewer(kind, random)
    positions = random_positions(viewer, random)
    matrix, translation = np.eye(4), random.normal(size=3) * 1e5
    matrix[:3] = random.normal(size=(3, 4))
    assume(abs(np.linalg.det(matrix)) > 0.1)
    transformed = positions @ matrix[:3, :3].T + matrix[:3, 3] + translation
    pixels, depths = viewer.project(positions)
    other_pixels, other_depths = viewer.transform(matrix, translation).project(transformed)
    is_in_front = depths > 1e-2 * viewer.projection.far
    assert np.allclose(depths, other_depths, atol=1e-5 * viewer.projection.far)
    assert np.allclose(pixels[is_in_front], other_pixels[is_in_front], rtol=1e-3, atol=0.1)


@pytest.mark.parametrize(("kind", "near", "far"), [("perspective", 20.0, 10.0), ("orthographic", 200.0, 200.0)])
def test_lengths_of_a_terrain_at_twice_its_size_cover_twice_the_pixels(kind, near, far):
    viewer = Viewer(np.eye(4), Projection(kind, (-1.0, 1.0, -0.5, 0.5), (200, 100), 0.1, 100.0))
    doubled = viewer.transform(np.diag([0.5, 0.5, 0.5, 1.0]))  # world to terrain
    assert 2.0 * viewer.pixels_per_unit_at(10.0) == pytest.approx(near)
    assert doubled.pixels_per_unit_at(np.array([5.0, 10.0])).tolist() == pytest.approx([near, far])


def test_a_panorama_has_no_outside():
    viewer = Viewer(np.eye(4), Projection("panoramic", FULL_SPHERE, (2000, 1000), 0.1, 100.0))
    assert viewer.frustum_planes().shape == (0, 4)
    assert viewer.pixels_per_unit_at(np.array([10.0])) == pytest.approx(2000 / (2.0 * math.pi * 10.0))
    assert viewer.projection.field_of_view == pytest.approx((2.0 * math.pi, math.pi))
    for use in (lambda: viewer.projection.matrix, lambda: viewer.project(np.zeros((1, 3)))):
        with pytest.raises(SettingsError, match="choose"):
            use()


def test_the_window_of_a_camera():
    assert camera_window(2.0, True, (0.0, 0.0), (200, 100)) == pytest.approx((-1.0, 1.0, -0.5, 0.5))
    assert camera_window(2.0, False, (0.0, 0.0), (200, 100)) == pytest.approx((-2.0, 2.0, -1.0, 1.0))
    assert camera_window(2.0, True, (0.25, -0.5), (200, 100)) == pytest.approx((-0.5, 1.5, -1.5, -0.5))
    assert camera_window(2.0, True, (0.0, 0.0), (200, 100), (1.0, 2.0)) == pytest.approx((-1.0, 1.0, -1.0, 1.0))
    right_angle = Projection("perspective", (-1.0, 1.0, -1.0, 1.0), (10, 10), 0.1, 10.0)
    assert right_angle.field_of_view == pytest.approx((math.pi / 2, math.pi / 2))


def test_viewers_are_compared_by_what_they_see():
    projection = Projection("perspective", (-1.0, 1.0, -1.0, 1.0), (10, 10), 0.1, 10.0)
    viewer = Viewer(np.eye(4), projection)
    assert viewer.is_same(Viewer(np.eye(4), projection)) and not viewer.is_same(None)
    assert not viewer.is_same(viewer.transform(np.eye(4), np.array([0.0, 0.0, 1e-9])))


@pytest.mark.parametrize("scale", [0.0, np.nan, np.inf])
def test_a_transform_without_inverse_is_a_sentence(scale):
    viewer = random_viewer("perspective", np.random.default_rng(0)).transform(np.diag([1.0, 1.0, scale, 1.0]))
    with pytest.raises(SettingsError, match="a scale of 0, or a transform that is not finite"):
        viewer.pixels_per_unit_at(np.ones(1))
