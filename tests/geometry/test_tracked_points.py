"""Points that remember the triangles near them find the same distances as a search among all triangles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.geometry.distance import TriangleTree, closest_on_mesh, squared_point_triangle_distances
from farfield.addon.core.geometry.tracked_points import TrackedPoints


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 0.02, 0.5]), st.sampled_from([0.0, 0.05, 1.0]))
@settings(max_examples=30, deadline=None)
def test_distances_to_moving_triangles_are_exact(seed, step, reach):
    random = np.random.default_rng(seed)
    corners, points = random.normal(size=(80, 3, 3)), 1.5 * random.normal(size=(60, 3))
    tracked = TrackedPoints(points, reach)
    for _ in range(5):
        distances, nearest = tracked.find_closest(corners)
        np.testing.assert_allclose(distances, closest_on_mesh(points, corners)[0], rtol=1e-9)
        np.testing.assert_allclose(distances, np.sqrt(squared_point_triangle_distances(points, corners[nearest])), rtol=1e-9)
        corners = corners + step * random.uniform(-1.0, 1.0, size=corners.shape)


def test_triangles_that_move_little_are_not_searched_again(monkeypatch):
    random = np.random.default_rng(0)
    corners = random.normal(size=(80, 3, 3))
    tracked = TrackedPoints(random.normal(size=(60, 3)), 0.5)
    tracked.find_closest(corners)
    monkeypatch.setattr(TriangleTree, "__init__", lambda *_: pytest.fail("All triangles were searched."))
    tracked.find_closest(corners + 0.01)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
@settings(max_examples=20, deadline=None)
def test_near_pairs_equal_brute_force(seed, reach):
    random = np.random.default_rng(seed)
    corners, points = random.normal(size=(40, 3, 3)), random.normal(size=(30, 3))
    distances = np.sqrt(squared_point_triangle_distances(np.repeat(points, 40, axis=0), np.tile(corners, (30, 1, 1)))).reshape(30, 40)
    expected = np.argwhere(distances <= distances.min(axis=1, keepdims=True) + reach)
    point, triangle, found = TriangleTree(corners).find_near(points, reach)
    assert np.array_equal(np.unique(np.column_stack([point, triangle]), axis=0), expected)
    assert len(point) == len(expected)
    np.testing.assert_allclose(found, distances[point, triangle])
