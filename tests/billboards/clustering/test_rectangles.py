"""Tests of the rectangles: the smallest one has the minimum area, and a crop is never worse than the whole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.clustering.rectangles import (
    approximate_min_area_axes,
    compute_bounds,
    crop_rectangle,
    enclosing_rectangle,
    is_inside,
    min_area_axes,
    rectangle_area,
)
from farfield.addon.core.geometry.convex_hulls import convex_hull

seeds = st.integers(0, 2**32 - 1)


def random_points(seed: int, count: int) -> np.ndarray:
    """Return points (count, 2) in a random ellipse at a random position."""
    random = np.random.default_rng(seed)
    return random.normal(size=(count, 2)) @ random.normal(size=(2, 2)) + 10.0 * random.normal(size=2)


def area_along(points: np.ndarray, axes: np.ndarray) -> float:
    return float(np.ptp(points @ axes.T, axis=0).prod())


def rotation_matrix(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


class TestMinAreaAxes:
    """Minimum-area rectangles compared with those at many angles."""

    @given(seeds, st.integers(3, 40))
    def test_no_other_angle_has_a_smaller_area(self, seed, count):
        points = random_points(seed, count)
        min_area = area_along(points, min_area_axes(points))
        brute_force = min(area_along(points, rotation_matrix(angle)) for angle in np.linspace(0.0, 0.5 * np.pi, 181))
        principal = np.linalg.svd(points - points.mean(axis=0))[2]
        assert min_area <= brute_force * (1.0 + 1e-9)
        assert min_area <= area_along(points, principal) * (1.0 + 1e-9)

    @given(seeds, st.integers(1, 40))
    def test_axes_are_right_handed_with_the_longer_side_first(self, seed, count):
        points = random_points(seed, count)
        for axes in (min_area_axes(points), approximate_min_area_axes(points)):
            np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
            assert np.linalg.det(axes) == pytest.approx(1.0)
            width, height = np.ptp(points @ axes.T, axis=0)
            assert width >= height * (1.0 - 1e-9)

    @given(seeds, st.floats(0.0, np.pi))
    def test_rotated_rectangle_is_found(self, seed, angle):
        random = np.random.default_rng(seed)
        corners = np.array([[-3.0, -1.0], [3.0, -1.0], [3.0, 1.0], [-3.0, 1.0]])
        points = np.concatenate([corners, random.uniform(-1.0, 1.0, (9, 2)) * [3.0, 1.0]]) @ rotation_matrix(angle) + random.normal(size=2)
        axes = min_area_axes(points)
        np.testing.assert_allclose(np.ptp(points @ axes.T, axis=0), [6.0, 2.0])
        np.testing.assert_allclose(np.abs(axes @ rotation_matrix(angle).T), np.eye(2), atol=1e-7)

    @given(seeds, st.integers(3, 40))
    def test_approximation_is_within_two_degrees(self, seed, count):
        """A rotation by d extends a side by at most the diagonal times sin d."""
        points = random_points(seed, count)
        width, height = np.ptp(points @ min_area_axes(points).T, axis=0)
        max_growth = np.hypot(width, height) * np.sin(0.25 * np.pi / 24)
        assert area_along(points, approximate_min_area_axes(points)) <= (width + max_growth) * (height + max_growth) * (1.0 + 1e-9)

    @pytest.mark.parametrize("count", [1, 2, 3, 7])
    def test_rectangle_of_points_on_a_line_has_no_height(self, count):
        points = np.arange(count)[:, None] * np.array([[3.0, 4.0]])
        np.testing.assert_allclose(np.ptp(points @ min_area_axes(points).T, axis=0), [5.0 * (count - 1), 0.0], atol=1e-9)


@given(seeds, st.integers(3, 30))
def test_hull_is_convex_and_contains_all_points(seed, count):
    points = random_points(seed, count)
    hull = convex_hull(points)
    edges = np.roll(hull, -1, axis=0) - hull
    inward = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    depth = np.einsum("hi,phi->ph", inward, points[:, None] - hull[None])
    assert depth.min() >= -1e-9 * np.abs(points).max() ** 2
    assert all((points == corner).all(axis=1).any() for corner in hull)


class TestBounds:
    """Bounds of primitives and rectangles around them."""

    def test_bounds_of_triangle_along_rotated_axes(self):
        corners = np.array([[[0.0, 0.0, 5.0], [2.0, 0.0, 6.0], [0.0, 3.0, 7.0]]])
        axes = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        np.testing.assert_array_equal(compute_bounds(corners, axes), [[0.0, 3.0, -2.0, 0.0]])

    @given(seeds, st.integers(1, 30))
    def test_enclosing_rectangle_is_tight(self, seed, count):
        bounds = random_bounds(seed, count)
        rectangle = enclosing_rectangle(bounds)
        assert is_inside(bounds, rectangle).all()
        for side, step in enumerate((1.0, -1.0, 1.0, -1.0)):
            smaller = rectangle.copy()
            smaller[side] += 1e-3 * step
            assert not is_inside(bounds, smaller).all()

    def test_area(self):
        assert rectangle_area(np.array([-1.0, 2.0, 3.0, 5.0])) == 6.0


def random_bounds(seed: int, count: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    low = random.normal(size=(count, 2)) * random.choice([1.0, 10.0], (count, 1))
    high = low + random.uniform(0.0, 1.0, (count, 2))
    return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)


class TestCropRectangle:
    """The worth of a rectangle: covered area over its own area plus a fixed cost."""

    @given(seeds, st.integers(1, 30), st.floats(0.01, 10.0))
    def test_crop_is_never_worse_than_no_crop(self, seed, count, fixed_cost):
        bounds = random_bounds(seed, count)
        areas = np.random.default_rng(seed).uniform(0.1, 1.0, count)
        worth, kept = crop_rectangle(bounds, areas, fixed_cost)
        assert worth == pytest.approx(areas[kept].sum() / (fixed_cost + rectangle_area(enclosing_rectangle(bounds[kept]))))
        assert worth >= areas.sum() / (fixed_cost + rectangle_area(enclosing_rectangle(bounds))) * (1.0 - 1e-12)
        assert len(np.unique(kept)) == len(kept) > 0

    @given(seeds, st.integers(2, 12), st.floats(0.01, 10.0))
    def test_no_single_cut_improves_the_crop(self, seed, count, fixed_cost):
        bounds = random_bounds(seed, count)
        areas = np.random.default_rng(seed).uniform(0.1, 1.0, count)
        worth, kept = crop_rectangle(bounds, areas, fixed_cost)
        for side, sign in enumerate((1.0, -1.0, 1.0, -1.0)):
            for limit in bounds[kept, side]:
                remaining = kept[sign * bounds[kept, side] >= sign * limit]
                cost = fixed_cost + rectangle_area(enclosing_rectangle(bounds[remaining]))
                assert areas[remaining].sum() / cost <= worth * (1.0 + 1e-6)

    def test_distant_sliver_is_cropped(self):
        squares = np.array([[x, x + 1.0, 0.0, 1.0] for x in (0.0, 1.0, 2.0, 50.0)])
        worth, kept = crop_rectangle(squares, np.array([1.0, 1.0, 1.0, 0.1]), 0.5)
        assert sorted(kept) == [0, 1, 2]
        assert worth == pytest.approx(3.0 / 3.5)

    def test_full_rectangle_is_not_cropped(self):
        squares = np.array([[x, x + 1.0, 0.0, 1.0] for x in range(5)], float)
        assert len(crop_rectangle(squares, np.ones(5), 1.0)[1]) == 5
