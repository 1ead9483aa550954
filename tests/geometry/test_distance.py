"""Point-to-mesh distances equal brute force over all triangles; Hausdorff bounds hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.geometry.distance import (
    TriangleTree,
    bound_hausdorff,
    closest_barycentric,
    closest_on_mesh,
    plane_barycentric,
    squared_point_triangle_distances,
)

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def brute_force_distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the distances by testing every triangle: projection onto the plane and onto the three edges."""
    result = np.full(len(points), np.inf)
    for triangle in corners:
        for index, point in enumerate(points):
            result[index] = min(result[index], point_triangle_distance(point, triangle))
    return result


def point_triangle_distance(point: np.ndarray, triangle: np.ndarray) -> float:
    best = np.inf
    for start, stop in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        length = (stop - start) @ (stop - start)
        t = 0.0 if length == 0.0 else np.clip((point - start) @ (stop - start) / length, 0.0, 1.0)
        best = min(best, float(np.linalg.norm(point - start - t * (stop - start))))
    edges = np.stack([triangle[1] - triangle[0], triangle[2] - triangle[0]], axis=1)
    weights, _, rank, _ = np.linalg.lstsq(edges, point - triangle[0], rcond=None)
    if rank == 2 and weights.min() >= 0.0 and weights.sum() <= 1.0:
        best = min(best, float(np.linalg.norm(point - triangle[0] - edges @ weights)))
    return best


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.sampled_from([1.0, 1e-6, 1e6]), st.floats(0.0, 3.0))
def test_distances_equal_brute_force(seed, count, unit, size_range):
    random = np.random.default_rng(seed)
    sizes = 10.0 ** random.uniform(-size_range, 0.0, (count, 1, 1))
    corners = unit * (random.normal(size=(count, 1, 3)) + sizes * random.normal(size=(count, 3, 3)))
    points = unit * random.normal(size=(12, 3)) * 1.5
    distances, nearest = closest_on_mesh(points, corners)
    np.testing.assert_allclose(distances, brute_force_distances(points, corners), rtol=1e-9, atol=1e-12 * unit)
    to_nearest = [point_triangle_distance(point, corners[index]) for point, index in zip(points, nearest, strict=True)]
    np.testing.assert_allclose(distances, to_nearest, rtol=1e-9, atol=1e-12 * unit)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_distances_are_exact_where_they_are_not_near_enough(seed):
    generator = np.random.default_rng(seed)
    corners, points = generator.normal(size=(60, 3, 3)), 2.0 * generator.normal(size=(50, 3))
    enough = generator.uniform(0.0, 2.0, len(points))
    exact, _ = closest_on_mesh(points, corners)
    distances, triangles = TriangleTree(corners).find_closest(points, enough)
    assert np.allclose(distances, np.sqrt(squared_point_triangle_distances(points, corners[triangles])))
    assert ((distances > enough) == (exact > enough)).all()
    assert np.allclose(distances[exact > enough], exact[exact > enough])


@pytest.mark.parametrize(
    ("point", "distance"),
    [((0.2, 0.2, 0.5), 0.5), ((0.2, 0.2, 0.0), 0.0), ((-3.0, -4.0, 0.0), 5.0), ((0.5, -2.0, 0.0), 2.0), ((1.0, 1.0, 0.0), np.sqrt(0.5))],
)
def test_known_distances_to_one_triangle(point, distance):
    assert closest_on_mesh(np.array([point]), TRIANGLE[None])[0][0] == pytest.approx(distance, abs=1e-15)


def test_triangles_without_area_count_as_segments():
    needle = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[9.0, 9.0, 9.0]] * 3])
    distances, nearest = closest_on_mesh(np.array([[1.5, 2.0, 0.0], [9.0, 9.0, 8.0]]), needle)
    np.testing.assert_allclose(distances, [2.0, 1.0])
    np.testing.assert_array_equal(nearest, [0, 1])


def test_no_points_give_no_distances():
    distances, nearest = closest_on_mesh(np.zeros((0, 3)), TRIANGLE[None])
    assert len(distances) == len(nearest) == 0


def test_barycentric_coordinates_give_the_closest_point_and_the_projection():
    random = np.random.default_rng(1)
    corners, points = random.normal(size=(200, 3, 3)), 2.0 * random.normal(size=(200, 3))
    weights = closest_barycentric(points, corners)
    assert weights.min() >= -1e-15
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    distances = np.linalg.norm(points - np.einsum("nk,nkj->nj", weights, corners), axis=1)
    np.testing.assert_allclose(
        distances, [point_triangle_distance(point, triangle) for point, triangle in zip(points, corners, strict=True)], rtol=1e-9
    )
    projection = np.einsum("nk,nkj->nj", plane_barycentric(points, corners), corners)
    edges = corners[:, 1:] - corners[:, :1]
    np.testing.assert_allclose(np.einsum("nej,nj->ne", edges, points - projection), 0.0, atol=1e-9)


def test_hausdorff_distance_is_found_inside_a_face():
    triangle = np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    left, right = triangle - [2.0, 0.0, 0.0], triangle + np.array([2.0, 0.0, 0.0])
    target = np.concatenate([left, right])
    distance = bound_hausdorff(np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-3, 0.0]]]), TriangleTree(target), 1e-3)[1]
    assert 1.0 <= distance <= 1.0 + 2e-3


def test_bounds_of_the_hausdorff_distance_differ_by_a_fraction_of_it():
    corners, target = np.random.default_rng(3).normal(size=(2, 30, 3, 3))
    exact = bound_hausdorff(corners, TriangleTree(target), 1e-6)[1]
    lower, upper = bound_hausdorff(corners, TriangleTree(target), 1e-6, precision=0.1)
    assert lower <= exact <= upper == pytest.approx(1.1 * lower)


def test_hausdorff_distance_of_parallel_sheets_is_their_gap_and_zero_to_itself():
    random = np.random.default_rng(2)
    sheet = random.normal(size=(40, 3, 3)) * [1.0, 1.0, 0.0]
    assert bound_hausdorff(sheet, TriangleTree(sheet), 1e-6)[1] <= 1e-6 + 1e-9
    gap = bound_hausdorff(sheet + np.array([0.0, 0.0, 0.25]), TriangleTree(sheet), 1e-6)[1]
    assert 0.25 <= gap <= 0.25 + 2e-6
