"""Tests of the primitives of meshes and point clouds: area, normal and covariance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.primitives import Primitives, drop_incomplete_points, from_mesh, from_points
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import PointCloud, TriangleMesh
from shapes import sheet, soup

seeds = st.integers(0, 2**32 - 1)


def total_covariance(primitives: Primitives) -> np.ndarray:
    """Return the covariance (3, 3) of the surface of all `primitives` together."""
    centroids = primitives.positions.mean(axis=1)
    centered = centroids - np.average(centroids, axis=0, weights=primitives.areas)
    covariances = primitives.covariances + centered[:, :, None] * centered[:, None]
    return np.average(covariances, axis=0, weights=primitives.areas)


def test_covariance_of_unit_square():
    np.testing.assert_allclose(total_covariance(from_mesh(sheet(1))), np.diag([1.0 / 12.0, 1.0 / 12.0, 0.0]), atol=1e-15)


@given(seeds)
def test_subdivision_does_not_change_covariance(seed):
    corners = soup(1, seed=seed).corners[0]
    midpoints = 0.5 * (corners + np.roll(corners, -1, axis=0))
    quarters = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]], np.int32)
    single = from_mesh(TriangleMesh(corners, np.array([[0, 1, 2]], np.int32)))
    subdivided = from_mesh(TriangleMesh(np.concatenate([corners, midpoints]), quarters))
    np.testing.assert_allclose(total_covariance(subdivided), total_covariance(single), atol=1e-12)
    assert subdivided.areas.sum() == pytest.approx(single.areas[0])


@given(seeds)
def test_disc_becomes_its_circumscribed_square(seed):
    random = np.random.default_rng(seed)
    normals = from_mesh(soup(10, seed=seed)).normals
    radii = random.uniform(0.1, 2.0, 10)
    squares = from_points(PointCloud(random.normal(size=(10, 3)), normals, radii))
    np.testing.assert_allclose(squares.areas, 4.0 * radii**2)
    sides = np.roll(squares.positions, -1, axis=1) - squares.positions
    np.testing.assert_allclose(np.linalg.norm(sides, axis=2), np.repeat(2.0 * radii[:, None], 4, axis=1))
    np.testing.assert_allclose(np.cross(sides[:, 0], sides[:, 1]), squares.areas[:, None] * normals, atol=1e-9)
    np.testing.assert_allclose(np.trace(squares.covariances, axis1=1, axis2=2), 2.0 * radii**2 / 3.0)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.inf, np.nan])
def test_points_without_a_radius_are_dropped_or_named(radius):
    points = np.random.default_rng(0).random((10, 3))
    normals, radii = np.tile([0.0, 0.0, 1.0], (10, 1)), np.ones(10)
    radii[3] = radius
    kept, indices = drop_incomplete_points(PointCloud(points, normals, radii, np.ones((10, 4))), "Dots")
    np.testing.assert_array_equal(indices, np.delete(np.arange(10), 3))
    assert len(kept.points) == len(kept.colors) == 9
    with pytest.raises(GeometryError, match='No point of "Dots" has a finite radius above 0; correct'):
        drop_incomplete_points(PointCloud(points, normals, np.full(10, radius)), "Dots")


def test_points_without_a_normal_are_named():
    points, radii = np.random.default_rng(0).random((2, 3)), np.ones(2)
    for normal in (0.0, np.nan, 5.0):
        with pytest.raises(GeometryError, match='No point of "Dots" has a normal; correct'):
            drop_incomplete_points(PointCloud(points, np.full((2, 3), normal), radii), "Dots")
    with pytest.raises(GeometryError, match='No point of "Dots" has both; correct its normals and radii'):
        drop_incomplete_points(PointCloud(points, np.array([[0.0, 0.0, 1.0], [0.0] * 3]), np.array([0.0, 1.0])), "Dots")
