"""Cutouts are convex, hold what the quad shows, and stay in its rectangle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.cutouts import cut_corners

seeds = st.integers(0, 2**32 - 1)
NO_ROOM = np.zeros(2)
DIAMOND = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


def sides_of(polygon: np.ndarray) -> np.ndarray:
    return np.roll(polygon, -1, axis=0) - polygon


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def polygon_area(polygon: np.ndarray) -> float:
    return 0.5 * float(cross(polygon, np.roll(polygon, -1, axis=0)).sum())


@given(seeds, st.integers(1, 40), st.integers(4, 8), st.floats(0.01, 0.3))
def test_convex_around_all_points_inside_the_square_with_few_corners(seed, count, most_corners, room):
    random = np.random.default_rng(seed)
    points = np.clip(random.normal(size=(count, 2)) * random.uniform(0.05, 1.0, 2), -1.0, 1.0)
    polygon = cut_corners(points, np.full(2, room), most_corners)
    assert 3 <= len(polygon) <= most_corners
    assert np.abs(polygon).max() <= 1.0 + 1e-12
    assert cross(sides_of(polygon), np.roll(sides_of(polygon), -1, axis=0)).min() >= -1e-12
    arms = np.array([[-room, -room], [room, -room], [room, room], [-room, room]])
    roomy = np.clip((points[:, None] + arms).reshape(-1, 2), -1.0, 1.0)
    assert cross(sides_of(polygon)[None], roomy[:, None] - polygon[None]).min() >= -1e-9


@given(seeds)
def test_more_corners_save_more(seed):
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (6, 2))
    areas = [polygon_area(cut_corners(points, NO_ROOM, corners)) for corners in range(4, 9)]
    assert areas[0] == pytest.approx(4.0)
    assert (np.diff(areas) <= 1e-12).all()


def test_a_diamond_is_cut_to_itself():
    polygon = cut_corners(DIAMOND, NO_ROOM, 8)
    assert polygon_area(polygon) == pytest.approx(2.0, abs=1e-6)


def test_a_full_square_stays_whole():
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    np.testing.assert_array_equal(cut_corners(corners, NO_ROOM, 8), corners)


def test_a_triangle_loses_the_corners_that_it_leaves_free():
    polygon = cut_corners(np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]), NO_ROOM, 6)
    assert polygon_area(polygon) < 2.3  # the triangle itself has 2
