"""Normals and radii estimated from points match the sampled surface."""

import numpy as np
import pytest

from farfield.addon.core.geometry.directions import fibonacci_sphere
from farfield.addon.core.geometry.points import estimate_normals, splat_radii


def sphere(count: int, center=(0.0, 0.0, 0.0), radius: float = 1.0) -> np.ndarray:
    return radius * fibonacci_sphere(count) + np.asarray(center)


def plane_grid(side: int, spacing: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(side) * spacing, np.arange(side) * spacing)
    return np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_normals_of_a_sphere_point_outwards(unit):
    points = sphere(2000)
    cosines = np.einsum("ij,ij->i", estimate_normals(unit * points), points)
    assert cosines.min() > np.cos(np.radians(5.0))


def test_every_component_is_oriented_outwards():
    first, second = sphere(800), sphere(800, center=(10.0, 0.0, 0.0), radius=0.5)
    normals = estimate_normals(np.concatenate([first, second]))
    assert np.einsum("ij,ij->i", normals[:800], first).min() > 0.9
    assert np.einsum("ij,ij->i", normals[800:], (second - [10.0, 0.0, 0.0]) / 0.5).min() > 0.9


def test_normals_of_a_plane_agree_in_sign():
    normals = estimate_normals(plane_grid(20, 0.3))
    np.testing.assert_allclose(np.abs(normals[:, 2]), 1.0)
    assert len(np.unique(np.sign(normals[:, 2]))) == 1


def test_rotating_the_cloud_rotates_its_normals():
    points = sphere(600) * [1.0, 0.8, 0.6]
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    np.testing.assert_allclose(estimate_normals(points @ rotation.T), estimate_normals(points) @ rotation.T, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_points_get_unit_normals(count):
    points = np.random.default_rng(count).normal(size=(count, 3))
    np.testing.assert_allclose(np.linalg.norm(estimate_normals(points), axis=1), 1.0)


def test_discs_close_a_square_grid():
    spacing = 0.3
    points = plane_grid(20, spacing)
    assert splat_radii(points).min() >= spacing / np.sqrt(2.0) * (1.0 - 1e-9)
    interior = splat_radii(points).reshape(20, 20)[2:-2, 2:-2]
    assert interior.max() <= spacing


def test_radii_scale_with_the_cloud_and_are_positive_at_duplicate_points():
    points = sphere(500)
    np.testing.assert_allclose(splat_radii(7.0 * points), 7.0 * splat_radii(points))
    duplicated = np.concatenate([points, np.repeat(points[:1], 20, axis=0)])
    assert splat_radii(duplicated).min() > 0.0
