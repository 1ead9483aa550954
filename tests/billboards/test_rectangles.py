"""The smallest rectangle is the smallest there is, and the worthwhile part of one is never worse than the whole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.rectangles import (
    area,
    around,
    bounds_of,
    convex_hull,
    inside,
    nearly_smallest_rectangle,
    smallest_rectangle,
    worthwhile_part,
)

seeds = st.integers(0, 2**32 - 1)


def scattered(seed: int, count: int) -> np.ndarray:
    """Points (count, 2) in a random ellipse at a random place."""
    random = np.random.default_rng(seed)
    return random.normal(size=(count, 2)) @ random.normal(size=(2, 2)) + 10.0 * random.normal(size=2)


def area_along(points: np.ndarray, axes: np.ndarray) -> float:
    return float(np.ptp(points @ axes.T, axis=0).prod())


def turned(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


class TestSmallestRectangle:
    """Freeman and Shapira's rectangle against every angle."""

    @given(seeds, st.integers(3, 40))
    def test_no_angle_has_a_smaller_one(self, seed, count):
        points = scattered(seed, count)
        smallest = area_along(points, smallest_rectangle(points))
        brute = min(area_along(points, turned(angle)) for angle in np.linspace(0.0, 0.5 * np.pi, 181))
        principal = np.linalg.svd(points - points.mean(axis=0))[2]
        assert smallest <= brute * (1.0 + 1e-9)
        assert smallest <= area_along(points, principal) * (1.0 + 1e-9)

    @given(seeds, st.integers(1, 40))
    def test_axes_are_a_right_handed_frame_with_the_longer_side_first(self, seed, count):
        points = scattered(seed, count)
        for axes in (smallest_rectangle(points), nearly_smallest_rectangle(points)):
            np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
            assert np.linalg.det(axes) == pytest.approx(1.0)
            width, height = np.ptp(points @ axes.T, axis=0)
            assert width >= height * (1.0 - 1e-9)

    @given(seeds, st.floats(0.0, np.pi))
    def test_a_turned_rectangle_is_found(self, seed, angle):
        random = np.random.default_rng(seed)
        corners = np.array([[-3.0, -1.0], [3.0, -1.0], [3.0, 1.0], [-3.0, 1.0]])
        points = np.concatenate([corners, random.uniform(-1.0, 1.0, (9, 2)) * [3.0, 1.0]]) @ turned(angle) + random.normal(size=2)
        axes = smallest_rectangle(points)
        np.testing.assert_allclose(np.ptp(points @ axes.T, axis=0), [6.0, 2.0])
        np.testing.assert_allclose(np.abs(axes @ turned(angle).T), np.eye(2), atol=1e-7)

    @given(seeds, st.integers(3, 40))
    def test_the_quick_one_is_within_two_degrees(self, seed, count):
        """A turn by d lets a side grow by no more than the diagonal times sin d."""
        points = scattered(seed, count)
        width, height = np.ptp(points @ smallest_rectangle(points).T, axis=0)
        grown = np.hypot(width, height) * np.sin(0.25 * np.pi / 24)
        assert area_along(points, nearly_smallest_rectangle(points)) <= (width + grown) * (height + grown) * (1.0 + 1e-9)

    @pytest.mark.parametrize("count", [1, 2, 3, 7])
    def test_points_on_a_line_have_no_height(self, count):
        points = np.arange(count)[:, None] * np.array([[3.0, 4.0]])
        np.testing.assert_allclose(np.ptp(points @ smallest_rectangle(points).T, axis=0), [5.0 * (count - 1), 0.0], atol=1e-9)


@given(seeds, st.integers(3, 30))
def test_a_hull_is_convex_and_holds_all(seed, count):
    points = scattered(seed, count)
    hull = convex_hull(points)
    edges = np.roll(hull, -1, axis=0) - hull
    across = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    depth = np.einsum("hi,phi->ph", across, points[:, None] - hull[None])
    assert depth.min() >= -1e-9 * np.abs(points).max() ** 2
    assert all((points == corner).all(axis=1).any() for corner in hull)


class TestBounds:
    """Boxes of pieces, and what lies in one."""

    def test_a_triangle_along_turned_axes(self):
        corners = np.array([[[0.0, 0.0, 5.0], [2.0, 0.0, 6.0], [0.0, 3.0, 7.0]]])
        axes = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        np.testing.assert_array_equal(bounds_of(corners, axes), [[0.0, 3.0, -2.0, 0.0]])

    @given(seeds, st.integers(1, 30))
    def test_what_is_around_all_holds_all_and_no_less(self, seed, count):
        bounds = random_bounds(seed, count)
        rectangle = around(bounds)
        assert inside(bounds, rectangle).all()
        for side, step in enumerate((1.0, -1.0, 1.0, -1.0)):
            smaller = rectangle.copy()
            smaller[side] += 1e-3 * step
            assert not inside(bounds, smaller).all()

    def test_area(self):
        assert area(np.array([-1.0, 2.0, 3.0, 5.0])) == 6.0


def random_bounds(seed: int, count: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    low = random.normal(size=(count, 2)) * random.choice([1.0, 10.0], (count, 1))
    high = low + random.uniform(0.0, 1.0, (count, 2))
    return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)


class TestWorthwhilePart:
    """What a rectangle is worth: covered area over its own and a fixed cost."""

    @given(seeds, st.integers(1, 30), st.floats(0.01, 10.0))
    def test_it_is_never_worse_than_the_whole_and_tells_its_worth(self, seed, count, fixed_cost):
        bounds = random_bounds(seed, count)
        areas = np.random.default_rng(seed).uniform(0.1, 1.0, count)
        worth, kept = worthwhile_part(bounds, areas, fixed_cost)
        assert worth == pytest.approx(areas[kept].sum() / (fixed_cost + area(around(bounds[kept]))))
        assert worth >= areas.sum() / (fixed_cost + area(around(bounds))) * (1.0 - 1e-12)
        assert len(np.unique(kept)) == len(kept) > 0

    @given(seeds, st.integers(2, 12), st.floats(0.01, 10.0))
    def test_no_single_cut_makes_it_better(self, seed, count, fixed_cost):
        bounds = random_bounds(seed, count)
        areas = np.random.default_rng(seed).uniform(0.1, 1.0, count)
        worth, kept = worthwhile_part(bounds, areas, fixed_cost)
        for side, sign in enumerate((1.0, -1.0, 1.0, -1.0)):
            for limit in bounds[kept, side]:
                left = kept[sign * bounds[kept, side] >= sign * limit]
                assert areas[left].sum() / (fixed_cost + area(around(bounds[left]))) <= worth * (1.0 + 1e-6)

    def test_a_far_sliver_is_left_behind(self):
        squares = np.array([[x, x + 1.0, 0.0, 1.0] for x in (0.0, 1.0, 2.0, 50.0)])
        worth, kept = worthwhile_part(squares, np.array([1.0, 1.0, 1.0, 0.1]), 0.5)
        assert sorted(kept) == [0, 1, 2]
        assert worth == pytest.approx(3.0 / 3.5)

    def test_a_full_rectangle_stays_whole(self):
        squares = np.array([[x, x + 1.0, 0.0, 1.0] for x in range(5)], float)
        assert len(worthwhile_part(squares, np.ones(5), 1.0)[1]) == 5
