"""Tests of the cutouts: they are convex, contain the points, and stay inside the rectangle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.levels import cut_corners

seeds = st.integers(0, 2**32 - 1)
NO_MARGIN = np.zeros(2)
DIAMOND = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])


def edge_vectors(polygon: np.ndarray) -> np.ndarray:
    return np.roll(polygon, -1, axis=0) - polygon


def cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def polygon_area(polygon: np.ndarray) -> float:
    return 0.5 * float(cross(polygon, np.roll(polygon, -1, axis=0)).sum())


@given(seeds, st.integers(1, 40), st.integers(4, 8), st.floats(0.01, 0.3))
def test_polygon_is_convex_and_contains_the_points(seed, count, max_corners, margin):
    random = np.random.default_rng(seed)
    points = np.clip(random.normal(size=(count, 2)) * random.uniform(0.05, 1.0, 2), -1.0, 1.0)
    polygon = cut_corners(points, np.full(2, margin), max_corners)
    assert 3 <= len(polygon) <= max_corners
    assert np.abs(polygon).max() <= 1.0 + 1e-12
    assert cross(edge_vectors(polygon), np.roll(edge_vectors(polygon), -1, axis=0)).min() >= -1e-12
    offsets = margin * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    with_margin = np.clip((points[:, None] + offsets).reshape(-1, 2), -1.0, 1.0)
    assert cross(edge_vectors(polygon)[None], with_margin[:, None] - polygon[None]).min() >= -1e-9


@given(seeds)
def test_more_corners_save_more_area(seed):
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (6, 2))
    areas = [polygon_area(cut_corners(points, NO_MARGIN, corners)) for corners in range(4, 9)]
    assert areas[0] == pytest.approx(4.0)
    assert (np.diff(areas) <= 1e-12).all()


def test_diamond_is_cut_exactly():
    polygon = cut_corners(DIAMOND, NO_MARGIN, 8)
    assert polygon_area(polygon) == pytest.approx(2.0, abs=1e-6)


def test_full_square_is_not_cut():
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    np.testing.assert_array_equal(cut_corners(corners, NO_MARGIN, 8), corners)


def test_square_around_triangle_loses_free_corners():
    polygon = cut_corners(np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]), NO_MARGIN, 6)
    assert polygon_area(polygon) < 2.3  # the area of the triangle is 2
