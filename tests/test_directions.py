"""Directions are unit vectors, spread as promised, and the octahedral maps go there and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core import directions

coordinates = st.floats(-1.0, 1.0)


def assert_unit(vectors: np.ndarray) -> None:
    assert np.linalg.norm(vectors, axis=-1) == pytest.approx(np.ones(vectors.shape[:-1]), abs=1e-12)


def nearest_angles(vectors: np.ndarray) -> np.ndarray:
    cosines = vectors @ vectors.T
    np.fill_diagonal(cosines, -1.0)
    return np.arccos(np.clip(cosines.max(axis=1), -1.0, 1.0))


@pytest.mark.parametrize("count", [1, 2, 12, 500])
def test_fibonacci_directions_are_unit_and_spread(count):
    vectors = directions.fibonacci_sphere(count)
    assert vectors.shape == (count, 3)
    assert_unit(vectors)
    if count >= 12:
        even = np.sqrt(4.0 * np.pi / count)
        assert nearest_angles(vectors).min() > 0.7 * even
        assert np.linalg.norm(vectors.mean(axis=0)) < 1.0 / count


def test_fibonacci_directions_integrate_a_quadratic():
    """The mean of d d^T over the sphere is a third of the identity."""
    vectors = directions.fibonacci_sphere(2000)
    assert vectors.T @ vectors / 2000 == pytest.approx(np.eye(3) / 3.0, abs=1e-3)


@given(coordinates, coordinates)
def test_octahedral_maps_round_trip(x, y):
    point = np.array([x, y])
    whole = directions.from_octahedral(point)
    assert_unit(whole)
    assert directions.from_octahedral(directions.to_octahedral(whole)) == pytest.approx(whole, abs=1e-9)
    upper = directions.from_hemi_octahedral(point)
    assert_unit(upper)
    assert upper[2] >= 0.0
    assert directions.to_hemi_octahedral(upper) == pytest.approx(point, abs=1e-9)


def test_octahedral_map_has_its_axes_where_they_belong():
    places = {(0, 0): (0, 0, 1), (1, 0): (1, 0, 0), (0, -1): (0, -1, 0), (1, 1): (0, 0, -1), (-1, 1): (0, 0, -1)}
    for place, axis in places.items():
        assert directions.from_octahedral(np.array(place, float)) == pytest.approx(axis, abs=1e-12)
    assert directions.to_octahedral(np.array([0.0, 0.0, 5.0])) == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("size", [1, 4, 9])
def test_grids_hold_every_cell_once(size):
    whole, upper = directions.octahedral_grid(size), directions.hemi_octahedral_grid(size)
    assert whole.shape == upper.shape == (size * size, 3)
    assert (upper[:, 2] > 0.0).all()
    cells = np.floor((directions.to_octahedral(whole) + 1.0) * 0.5 * size).astype(int)
    assert len(np.unique(cells, axis=0)) == size * size


@given(st.integers(0, 2**32 - 1))
def test_held_out_views_are_spread_and_off_the_axes(seed):
    views = directions.held_out_views(12, seed)
    assert views.shape == (12, 3)
    assert_unit(views)
    assert np.abs(views).max() < np.cos(np.radians(10.0))
    assert nearest_angles(views).min() > np.radians(40.0)
    assert (views == directions.held_out_views(12, seed)).all()
