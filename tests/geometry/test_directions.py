"""Directions are evenly distributed unit vectors; octahedral and spherical coordinates round-trip."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.geometry import directions

COORDINATES = st.floats(-1.0, 1.0)


def assert_unit(vectors: np.ndarray) -> None:
    assert np.linalg.norm(vectors, axis=-1) == pytest.approx(np.ones(vectors.shape[:-1]), abs=1e-12)


def nearest_angles(vectors: np.ndarray) -> np.ndarray:
    cosines = vectors @ vectors.T
    np.fill_diagonal(cosines, -1.0)
    return np.arccos(np.clip(cosines.max(axis=1), -1.0, 1.0))


@pytest.mark.parametrize("count", [1, 2, 12, 500])
def test_fibonacci_directions_are_evenly_distributed_unit_vectors(count):
    vectors = directions.fibonacci_sphere(count)
    assert vectors.shape == (count, 3)
    assert_unit(vectors)
    if count >= 12:
        spacing = np.sqrt(4.0 * np.pi / count)
        assert nearest_angles(vectors).min() > 0.7 * spacing
        assert np.linalg.norm(vectors.mean(axis=0)) < 1.0 / count


def test_fibonacci_directions_integrate_a_quadratic():
    """The mean of d d^T over the sphere is a third of the identity."""
    vectors = directions.fibonacci_sphere(2000)
    assert vectors.T @ vectors / 2000 == pytest.approx(np.eye(3) / 3.0, abs=1e-3)


@settings(max_examples=30)
@given(COORDINATES, COORDINATES)
def test_octahedral_maps_round_trip(x, y):
    point = np.array([x, y])
    direction = directions.from_octahedral(point)
    assert_unit(direction)
    assert directions.from_octahedral(directions.to_octahedral(direction)) == pytest.approx(direction, abs=1e-9)
    upper = directions.from_hemi_octahedral(point)
    assert_unit(upper)
    assert upper[2] >= 0.0
    assert directions.to_hemi_octahedral(upper) == pytest.approx(point, abs=1e-9)


def test_octahedral_map_of_the_coordinate_axes():
    axes = {(0, 0): (0, 0, 1), (1, 0): (1, 0, 0), (0, -1): (0, -1, 0), (1, 1): (0, 0, -1), (-1, 1): (0, 0, -1)}
    for point, axis in axes.items():
        assert directions.from_octahedral(np.array(point, float)) == pytest.approx(axis, abs=1e-12)
    assert directions.to_octahedral(np.array([0.0, 0.0, 5.0])) == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("size", [1, 4, 9])
def test_grids_contain_every_cell_once(size):
    full, upper = directions.octahedral_grid(size), directions.hemi_octahedral_grid(size)
    assert full.shape == upper.shape == (size * size, 3)
    assert (upper[:, 2] > 0.0).all()
    cells = np.floor((directions.to_octahedral(full) + 1.0) * 0.5 * size).astype(int)
    assert len(np.unique(cells, axis=0)) == size * size


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_held_out_views_are_distributed_and_off_the_axes(seed):
    views = directions.held_out_views(12, seed)
    assert views.shape == (12, 3)
    assert_unit(views)
    assert np.abs(views).max() < np.cos(np.radians(10.0))
    assert nearest_angles(views).min() > np.radians(40.0)
    assert (views == directions.held_out_views(12, seed)).all()


@settings(max_examples=30)
@given(st.floats(0.01, np.pi - 0.01), st.floats(0.0, 2.0 * np.pi, exclude_max=True))
def test_spherical_angles_round_trip(polar, azimuth):
    angles = np.array([[polar, azimuth]])
    vectors = directions.from_spherical(angles)
    assert_unit(vectors)
    np.testing.assert_allclose(directions.from_spherical(directions.to_spherical(vectors)), vectors, atol=1e-12)
    assert directions.to_spherical(vectors)[0, 0] == pytest.approx(polar)


def test_bonn_directions_are_six_rings_around_the_pole():
    vectors = directions.bonn_directions()
    assert vectors.shape == (81, 3)
    assert_unit(vectors)
    polar, azimuths = np.degrees(directions.to_spherical(vectors)).T
    rings, counts = np.unique(np.rint(polar), return_counts=True)
    assert rings.tolist() == [0.0, 15.0, 30.0, 45.0, 60.0, 75.0]
    assert counts.tolist() == [1, 6, 12, 18, 20, 24]
    assert np.rint(azimuths[1:7]).tolist() == [0.0, 60.0, 120.0, 180.0, 240.0, 300.0]
    assert nearest_angles(vectors).min() > np.radians(12.0)
