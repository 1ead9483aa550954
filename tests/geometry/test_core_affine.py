"""Points under affine transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.geometry.transforms import inverse_transform_points, transform_points


def test_a_known_transform():
    matrix = np.array([[0, -2, 0, 5], [1, 0, 0, 6], [0, 0, 3, 7], [0, 0, 0, 1]], np.float32)
    moved = transform_points(matrix, np.array([[1, 0, 0], [0, 1, 1]], np.float32))
    assert moved.dtype == np.float64 and moved.tolist() == [[5, 7, 7], [3, 6, 10]]
    assert transform_points(matrix, np.array([1.0, 0.0, 0.0])).tolist() == [5, 7, 7]
    assert transform_points(matrix, np.zeros((0, 3))).shape == (0, 3)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 20))
def test_the_inverse_gives_the_points_back_and_products_compose(seed, count):
    random = np.random.default_rng(seed)
    first, second = np.eye(4), np.eye(4)
    for matrix in (first, second):
        matrix[:3, :3], matrix[:3, 3] = np.linalg.qr(random.normal(size=(3, 3)))[0] * random.uniform(0.1, 10.0, 3), random.normal(size=3)
    points = random.normal(size=(count, 3))
    np.testing.assert_allclose(inverse_transform_points(first, transform_points(first, points)), points, atol=1e-9)
    expected = transform_points(second, transform_points(first, points))
    np.testing.assert_allclose(transform_points(second @ first, points), expected, atol=1e-9)
    homogeneous = np.column_stack([points, np.ones(count)]) @ first.T
    np.testing.assert_allclose(transform_points(first, points), homogeneous[:, :3], atol=1e-12)


def test_a_singular_matrix_has_no_inverse():
    with pytest.raises(np.linalg.LinAlgError):
        inverse_transform_points(np.diag([1.0, 1.0, 0.0, 1.0]), np.ones((2, 3)))
