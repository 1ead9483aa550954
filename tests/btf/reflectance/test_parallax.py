"""Parallax offsets: known values, their limits, and a curved surface that a flat quad replaces."""

import dataclasses

import numpy as np
import pytest

from farfield.addon.core.billboards.texels import QuadPolygons, texels_under_quads
from farfield.addon.core.btf.reflectance.parallax import MAX_OFFSET, ParallaxMap, parallax_axes

SIDE, ERROR = 16, 1.0
VIEW = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)


def rotated_texels():
    """Return the texels of one horizontal quad of 16 x 16 texels of side 0.5. Its texture is rotated by 90 degrees: its x runs along -y."""
    corners = np.array([[0, 0], [0, -8], [8, -8], [8, 0]], float)
    coordinates = np.array([[0, 0], [16, 0], [16, 16], [0, 16]], float)
    return texels_under_quads(QuadPolygons([np.column_stack([corners, np.zeros(4)])], [coordinates]), (SIDE, SIDE))


def parallax_map(depths: np.ndarray, normals: np.ndarray | None = None) -> ParallaxMap:
    texels = rotated_texels()
    normals = np.tile(np.float32([0.0, 0.0, 1.0]), (SIDE, SIDE, 1)) if normals is None else normals
    return ParallaxMap(texels.pixels, texels.quad_indices, parallax_axes(texels, ERROR), depths, normals)


@pytest.mark.parametrize(("depth", "offset"), [(0.0, 0.0), (0.25, 0.5), (-0.5, -1.0), (1.0, MAX_OFFSET), (-1.0, -MAX_OFFSET)])
def test_offsets_at_45_degrees_equal_the_height(depth, offset):
    """A height of a quarter of the error is half a texel."""
    offsets = parallax_map(np.full(SIDE**2, depth)).offsets(VIEW)
    np.testing.assert_allclose(offsets, np.tile([0.0, offset], (SIDE**2, 1)), atol=1e-9)


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_quads_too_small_or_large_for_numbers_have_no_parallax(scale):
    texels = rotated_texels()
    axes = parallax_axes(dataclasses.replace(texels, steps=texels.steps * scale), ERROR)
    offsets = ParallaxMap(texels.pixels, texels.quad_indices, axes, np.full(SIDE**2, 0.5), np.zeros((SIDE, SIDE, 3))).offsets(VIEW)
    assert np.isfinite(offsets).all()


def test_offsets_are_zero_for_perpendicular_and_edge_on_views():
    raised = parallax_map(np.full(SIDE**2, 0.5))
    np.testing.assert_allclose(raised.offsets(np.array([0.0, 0.0, 1.0])), 0.0, atol=1e-12)
    np.testing.assert_allclose(raised.offsets(np.array([1.0, 0.0, 0.0])), 0.0, atol=1e-12)


def test_offsets_from_below_have_the_opposite_sign():
    raised = parallax_map(np.full(SIDE**2, 0.25))
    np.testing.assert_allclose(raised.offsets(-VIEW), raised.offsets(VIEW), atol=1e-12)
    np.testing.assert_allclose(raised.offsets(VIEW * [1, 1, -1]), -raised.offsets(VIEW), atol=1e-12)


def test_normals_of_a_sphere_are_found_at_oblique_views():
    """A spherical cap within the error of the quad, against exact ray intersections."""
    texels, radius = rotated_texels(), 20.0
    center = np.array([4.0, -4.0, -radius + 0.3])
    from_axis = texels.positions[:, :2] - center[:2]
    heights = np.sqrt(radius**2 - (from_axis**2).sum(axis=1)) + center[2]
    assert np.abs(heights).max() < ERROR
    normals = (np.column_stack([texels.positions[:, :2], heights]) - center) / radius
    parallax = parallax_map(heights / ERROR, texels.to_image(normals.astype(np.float32)))
    for view in (VIEW, np.array([-0.5, 0.4, 0.9]) / np.linalg.norm([-0.5, 0.4, 0.9])):
        origin = texels.positions - center
        distances = -origin @ view + np.sqrt((origin @ view) ** 2 - (origin**2).sum(axis=1) + radius**2)
        hits = texels.positions + distances[:, None] * view
        inside = ((hits[:, 0] > 0.5) & (hits[:, 0] < 7.5) & (hits[:, 1] < -0.5) & (hits[:, 1] > -7.5)).nonzero()[0]
        truth = (hits[inside] - center) / radius
        errors = np.degrees(np.arccos(np.clip((parallax.sample_normals(view, inside) * truth).sum(axis=1), -1.0, 1.0)))
        errors_without = np.degrees(np.arccos(np.clip((normals[inside] * truth).sum(axis=1), -1.0, 1.0)))
        assert errors.mean() < 0.2 * errors_without.mean()
