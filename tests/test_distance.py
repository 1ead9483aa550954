"""The distance from points to a mesh is the least over all its triangles, and every bound of it holds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.distance import closest_on_mesh, closest_weights, one_sided_distance, plane_weights

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def by_all_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The distances by trying every triangle: projection onto the plane and onto the three edges, one by one."""
    result = np.full(len(points), np.inf)
    for triangle in corners:
        for index, point in enumerate(points):
            result[index] = min(result[index], by_parts(point, triangle))
    return result


def by_parts(point: np.ndarray, triangle: np.ndarray) -> float:
    best = np.inf
    for start, stop in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        length = (stop - start) @ (stop - start)
        share = 0.0 if length == 0.0 else np.clip((point - start) @ (stop - start) / length, 0.0, 1.0)
        best = min(best, float(np.linalg.norm(point - start - share * (stop - start))))
    edges = np.stack([triangle[1] - triangle[0], triangle[2] - triangle[0]], axis=1)
    weights, _, rank, _ = np.linalg.lstsq(edges, point - triangle[0], rcond=None)
    if rank == 2 and weights.min() >= 0.0 and weights.sum() <= 1.0:
        best = min(best, float(np.linalg.norm(point - triangle[0] - edges @ weights)))
    return best


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.sampled_from([1.0, 1e-6, 1e6]), st.floats(0.0, 3.0))
def test_it_is_the_least_over_all_triangles(seed, count, unit, spread):
    random = np.random.default_rng(seed)
    sizes = 10.0 ** random.uniform(-spread, 0.0, (count, 1, 1))
    corners = unit * (random.normal(size=(count, 1, 3)) + sizes * random.normal(size=(count, 3, 3)))
    points = unit * random.normal(size=(12, 3)) * 1.5
    distances, nearest = closest_on_mesh(points, corners)
    np.testing.assert_allclose(distances, by_all_triangles(points, corners), rtol=1e-9, atol=1e-12 * unit)
    named = [by_parts(point, corners[index]) for point, index in zip(points, nearest, strict=True)]
    np.testing.assert_allclose(distances, named, rtol=1e-9, atol=1e-12 * unit)


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


def test_no_points_have_no_distances():
    distances, nearest = closest_on_mesh(np.zeros((0, 3)), TRIANGLE[None])
    assert len(distances) == len(nearest) == 0


def test_weights_name_the_closest_point_and_the_foot_on_the_plane():
    random = np.random.default_rng(1)
    corners, points = random.normal(size=(200, 3, 3)), 2.0 * random.normal(size=(200, 3))
    weights = closest_weights(points, corners)
    assert weights.min() >= -1e-15
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    reached = np.linalg.norm(points - np.einsum("nk,nkj->nj", weights, corners), axis=1)
    np.testing.assert_allclose(reached, [by_parts(point, triangle) for point, triangle in zip(points, corners, strict=True)], rtol=1e-9)
    foot = np.einsum("nk,nkj->nj", plane_weights(points, corners), corners)
    edges = corners[:, 1:] - corners[:, :1]
    np.testing.assert_allclose(np.einsum("nej,nj->ne", edges, points - foot), 0.0, atol=1e-9)


def test_one_sided_distance_sees_what_no_corner_sees():
    roof = np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    far_left, far_right = roof - [2.0, 0.0, 0.0], roof + np.array([2.0, 0.0, 0.0])
    target = np.concatenate([far_left, far_right])
    distance = one_sided_distance(np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-3, 0.0]]]), target, 1e-3)
    assert 1.0 <= distance <= 1.0 + 2e-3


def test_one_sided_distance_between_parallel_sheets_is_their_gap_and_zero_to_itself():
    random = np.random.default_rng(2)
    sheet = random.normal(size=(40, 3, 3)) * [1.0, 1.0, 0.0]
    assert one_sided_distance(sheet, sheet, 1e-6) <= 1e-6 + 1e-9
    gap = one_sided_distance(sheet + np.array([0.0, 0.0, 0.25]), sheet, 1e-6)
    assert 0.25 <= gap <= 0.25 + 2e-6
