"""Triangles and discs are one kind of thing: flat pieces with area, normal and spread."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.primitives import Primitives, from_mesh, from_points
from farfield.addon.core.mesh import PointCloud, TriangleMesh
from shapes import sheet, soup

seeds = st.integers(0, 2**32 - 1)


def spread(primitives: Primitives) -> np.ndarray:
    """Covariance (3, 3) of the surface of all `primitives` together."""
    middles = primitives.positions.mean(axis=1)
    centred = middles - np.average(middles, axis=0, weights=primitives.areas)
    within = primitives.covariances + centred[:, :, None] * centred[:, None]
    return np.average(within, axis=0, weights=primitives.areas)


def test_a_unit_square_spreads_a_twelfth():
    np.testing.assert_allclose(spread(from_mesh(sheet(1))), np.diag([1.0 / 12.0, 1.0 / 12.0, 0.0]), atol=1e-15)


@given(seeds)
def test_cutting_a_triangle_in_four_changes_no_spread(seed):
    corners = soup(1, seed=seed).corners[0]
    middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
    quarters = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]], np.int32)
    whole = from_mesh(TriangleMesh(corners, np.array([[0, 1, 2]], np.int32)))
    cut = from_mesh(TriangleMesh(np.concatenate([corners, middles]), quarters))
    np.testing.assert_allclose(spread(cut), spread(whole), atol=1e-12)
    assert cut.areas.sum() == pytest.approx(whole.areas[0])


@given(seeds)
def test_a_disc_is_the_square_around_it_in_its_tangent_plane(seed):
    random = np.random.default_rng(seed)
    normals = from_mesh(soup(10, seed=seed)).normals
    radii = random.uniform(0.1, 2.0, 10)
    squares = from_points(PointCloud(random.normal(size=(10, 3)), normals, radii))
    np.testing.assert_allclose(squares.areas, 4.0 * radii**2)
    sides = np.roll(squares.positions, -1, axis=1) - squares.positions
    np.testing.assert_allclose(np.linalg.norm(sides, axis=2), np.repeat(2.0 * radii[:, None], 4, axis=1))
    np.testing.assert_allclose(np.cross(sides[:, 0], sides[:, 1]), squares.areas[:, None] * normals, atol=1e-9)
    np.testing.assert_allclose(np.trace(squares.covariances, axis1=1, axis2=2), 2.0 * radii**2 / 3.0)
