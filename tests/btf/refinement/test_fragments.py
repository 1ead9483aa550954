"""Rays hit the quads below them, from near to far, and sample the right texels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.billboards.texels import QuadPolygons, texels_under_quads
from farfield.addon.core.btf.refinement.fragments import Fragments, find_fragments
from farfield.addon.core.geometry.cameras import OrthographicView

SIZE = (20, 12)


def two_sheets(height: float = 2.0) -> QuadPolygons:
    """Return a sheet of 8 x 8 texels of unit size, and a second one at z = `height` above its right half."""
    flat = np.array([[0, 0], [8, 0], [8, 8], [0, 8]], float)
    narrow = np.array([[4, 0], [8, 0], [8, 8], [4, 8]], float)
    lifted = np.column_stack([narrow, np.full(4, height)])
    return QuadPolygons([np.column_stack([flat, np.zeros(4)]), lifted], [flat + [1.0, 1.0], narrow + [7.0, 1.0]])


def view_from(direction, resolution: int = 8) -> OrthographicView:
    direction = np.array(direction, float)
    return OrthographicView(direction / np.linalg.norm(direction), np.array([4.0, 4.0, 0.0]), resolution, 8.0 / resolution)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1)])
def test_every_ray_hits_the_quads_below_it(direction):
    quads = two_sheets()
    texels = texels_under_quads(quads, SIZE)
    fragments = find_fragments(quads, texels, view_from(direction), 2)
    per_pixel = np.bincount(fragments.ray_indices // 4, minlength=64).reshape(8, 8)
    right_half = slice(4, 8)  # also from below: x points to the right in both views
    assert (per_pixel[:, right_half] == 8).all() and per_pixel.sum() == 4 * 64 + 4 * 32
    nearest = texels.quad_indices[fragments.texel_indices[fragments.starts, 0]].reshape(8, 8, 4)
    assert (nearest[:, right_half] == (1 if direction[2] > 0 else 0)).all()


def test_a_ray_through_the_center_of_a_texel_samples_it_alone():
    quads = two_sheets()
    texels = texels_under_quads(quads, SIZE)
    fragments = find_fragments(quads, texels, view_from((0, 0, 1)), 1)
    is_lower = texels.quad_indices[fragments.texel_indices[:, 0]] == 0
    lower = np.flatnonzero(is_lower & (fragments.weights.max(axis=1) > 0.999))
    sampled = fragments.texel_indices[lower, fragments.weights[lower].argmax(axis=1)]
    row, column = np.divmod(fragments.ray_indices[lower], 8)
    np.testing.assert_array_equal(texels.pixels[sampled] - 1, np.column_stack([column, row]))
    assert len(lower) == 64


def test_taps_stay_within_their_quad():
    quads = two_sheets()
    texels = texels_under_quads(quads, SIZE)
    fragments = find_fragments(quads, texels, view_from((0.3, -0.2, 1.0), 24), 2)
    tap_quads = texels.quad_indices[fragments.texel_indices]
    assert (tap_quads == tap_quads[:, :1]).all()
    assert (fragments.weights.sum(axis=1) <= 1.0 + 1e-6).all() and (fragments.weights.sum(axis=1) > 0.0).all()


def test_edge_on_quads_have_no_fragments():
    quads = two_sheets()
    texels = texels_under_quads(quads, SIZE)
    assert len(find_fragments(quads, texels, view_from((1, 0, 0)), 2)) == 0


def intersect_brute_force(quads: QuadPolygons, view: OrthographicView) -> list[tuple[int, int]]:
    """Return ray and quad of every intersection, by half-plane tests."""
    hits = []
    for quad, corners in enumerate(quads.corners):
        outline = view.project(corners)[0]
        following = np.roll(outline, -1, axis=0)
        orientation = np.sign((outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum())
        for ray in range(view.resolution**2):
            to_ray = np.array([ray % view.resolution, ray // view.resolution]) + 0.5 - outline
            edges = following - outline
            if (orientation * (edges[:, 0] * to_ray[:, 1] - edges[:, 1] * to_ray[:, 0]) >= 0.0).all():
                hits.append((ray, quad))
    return sorted(hits)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_polygons_of_any_corner_count_match_half_plane_tests(seed):
    """Polygons of three to six corners, some of them partly outside the image."""
    random = np.random.default_rng(seed)
    corners, coordinates = [], []
    for index, count in enumerate((3, 6, 4, 5)):
        angles = np.sort(random.uniform(0.0, 2.0 * np.pi, count))
        flat = np.column_stack([np.cos(angles), np.sin(angles)]) * random.uniform(0.5, 5.0, 2)
        corners.append(np.column_stack([flat + random.uniform(0.0, 8.0, 2), np.full(count, float(index))]))
        coordinates.append(flat + [6.0 + 12.0 * index, 6.0])
    quads = QuadPolygons(corners, coordinates)
    texels, view = texels_under_quads(quads, (50, 12)), view_from((0.2, 0.1, 1.0), 13)
    fragments = find_fragments(quads, texels, view, 1)
    quad_indices = texels.quad_indices[fragments.texel_indices[np.arange(len(fragments)), fragments.weights.argmax(axis=1)]]
    hits = sorted(zip(fragments.ray_indices.tolist(), quad_indices.tolist(), strict=True))
    assert hits == intersect_brute_force(quads, view)


@pytest.mark.parametrize("cosine", [1e-9, 1e-8, 1e-6, 1e-3])
def test_texture_coordinates_of_nearly_edge_on_quads_are_accurate(cosine):
    """An oblique quad that is projected to a thin line through the center of a pixel."""
    tangent, up = np.array([0.8, 0.6, 0.0]), np.array([-0.6, 0.8, 0.0])
    bitangent = cosine * up + np.array([0.0, 0.0, 1.0])
    center = np.array([4.5, 4.5, 0.0])
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    quads = QuadPolygons([center + 3.0 * signs[:, :1] * tangent + 3.0 * signs[:, 1:] * bitangent], [3.0 * signs + 5.0])
    texels = texels_under_quads(quads, SIZE)
    view = OrthographicView(np.array([0.0, 0.0, 1.0]), np.array([4.0, 4.0, 0.0]), 8, 1.0)
    fragments = find_fragments(quads, texels, view, 1)
    assert np.isfinite(fragments.weights).all()
    if len(fragments):
        weighted = texels.pixels[fragments.texel_indices] * fragments.weights[..., None]
        sampled = weighted.sum(axis=1) / fragments.weights.sum(axis=1, keepdims=True) + 0.5
        row, column = np.divmod(fragments.ray_indices, 8)
        expected = (np.column_stack([column, row]) + 0.5 - center[:2]) @ tangent[:2] + 5.0
        np.testing.assert_allclose(np.clip(sampled[:, 0], 2.5, 7.5), np.clip(expected, 2.5, 7.5), atol=0.01)


def test_without_quads_there_are_no_fragments():
    assert len(find_fragments(QuadPolygons([], []), texels_under_quads(two_sheets(), SIZE), view_from((0, 0, 1)), 2)) == 0


@given(st.lists(st.lists(st.floats(0.0, 0.999), max_size=5), min_size=1, max_size=6))
def test_transmittance_and_sums_match_their_definitions(ray_alphas):
    lengths = [len(alphas) for alphas in ray_alphas]
    ray_indices = np.repeat(np.arange(len(ray_alphas)), lengths).astype(np.int32)
    count = len(ray_indices)
    fragments = Fragments(len(ray_alphas), ray_indices, np.zeros((count, 4), np.int32), np.zeros((count, 4), np.float32))
    transmittance = fragments.transmittance(np.concatenate([np.array(alphas) for alphas in ray_alphas]))
    expected = [np.cumprod([1.0, *(1.0 - np.array(alphas))])[:-1] if alphas else np.zeros(0) for alphas in ray_alphas]
    np.testing.assert_allclose(transmittance, np.concatenate(expected), rtol=1e-4, atol=1e-6)
    values = np.arange(1.0, count + 1.0)
    by_ray = np.split(values, np.cumsum(lengths)[:-1])
    expected_sums = np.concatenate([own.sum() - np.cumsum(own) for own in by_ray])
    np.testing.assert_allclose(fragments.sum_behind(values), expected_sums, rtol=1e-5)
