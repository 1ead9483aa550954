"""Dilation keeps known texels and fills the others; alpha and silhouettes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.imaging.images import dilate, grow_silhouette, sample_bilinear, unpremultiply


@settings(max_examples=40)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.02, 0.9), st.integers(0, 2**32 - 1))
def test_dilation_keeps_known_texels_and_stays_within_their_range(height, width, fraction, seed):
    random = np.random.default_rng(seed)
    image = random.random((height, width, 3), np.float32)
    known = random.random((height, width)) < fraction
    filled = dilate(image, known)
    assert (filled[known] == image[known]).all()
    if known.any():
        assert np.isfinite(filled).all()
        assert (filled >= image[known].min(axis=0) - 1e-5).all() and (filled <= image[known].max(axis=0) + 1e-5).all()


def test_two_charts_keep_their_colors_up_to_the_center_of_the_gutter():
    image, known = np.zeros((12, 20, 1), np.float32), np.zeros((12, 20), bool)
    known[:, :8], known[:, 12:] = True, True
    image[:, 12:] = 1.0
    filled = dilate(image, known, 2)
    assert (filled[:, :10] == 0.0).all() and (filled[:, 10:] == 1.0).all()


def test_an_image_with_nothing_known_is_unchanged():
    image = np.full((3, 5, 2), 7.0, np.float32)
    assert dilate(image, np.zeros((3, 5))) is image


def test_unpremultiply_inverts_premultiplication():
    straight = np.random.default_rng(3).random((4, 4, 4), np.float32)
    straight[0, :, 3] = 0.0
    premultiplied = straight.copy()
    premultiplied[..., :3] *= straight[..., 3:]
    result = unpremultiply(premultiplied)
    assert result[1:] == pytest.approx(straight[1:], abs=1e-5)
    assert (result[0] == 0.0).all()


def test_silhouettes_grow_by_one_texel_within_the_region_only():
    image = np.zeros((8, 8, 4), np.float32)
    image[3:5, 2:5] = [0.2, 0.4, 0.6, 1.0]
    image[6, 6] = [0.1, 0.0, 0.0, 0.5]
    left = np.zeros((8, 8), bool)
    left[:, :5] = True
    grown = grow_silhouette(image, left, np.zeros((8, 8), int))
    expected = image[..., 3].copy()
    expected[2, 2:5] = expected[5, 2:5] = expected[3:5, 1] = 1.0
    np.testing.assert_array_equal(grown[..., 3], expected)
    np.testing.assert_allclose(grown[2, 3], [0.2, 0.4, 0.6, 1.0], atol=1e-6)
    np.testing.assert_allclose(grown[~left], image[~left], atol=1e-6)


def test_charts_that_touch_neither_grow_nor_fill_each_other():
    """A red opaque chart next to a green one with a transparent seam, and one without any coverage."""
    regions = np.repeat([[0] * 4 + [1] * 4 + [2] * 4], 6, axis=0)
    image = np.zeros((6, 12, 4), np.float32)
    image[:, :4] = [1.0, 0.0, 0.0, 1.0]
    image[:, 6:8] = [0.0, 0.5, 0.0, 0.5]
    grown = grow_silhouette(image, np.ones((6, 12), bool), regions)
    np.testing.assert_array_equal(grown[0, :, 3], [1, 1, 1, 1, 0, 0.5, 0.5, 0.5, 0, 0, 0, 0])
    filled = dilate(unpremultiply(image)[..., :3], image[..., 3], regions=regions)
    np.testing.assert_array_equal(filled[:, :4], np.broadcast_to([1.0, 0.0, 0.0], (6, 4, 3)))
    np.testing.assert_array_equal(filled[:, 4:8], np.broadcast_to([0.0, 1.0, 0.0], (6, 4, 3)))


def test_bilinear_samples_reproduce_pixel_centers_and_linear_ramps():
    image = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1)
    centers = np.stack(np.meshgrid(np.arange(5) + 0.5, np.arange(4) + 0.5), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(sample_bilinear(image, centers), image.reshape(-1, 2))
    positions = np.random.default_rng(0).uniform(0.5, 3.5, (50, 2))
    np.testing.assert_allclose(sample_bilinear(image, positions), positions - 0.5)
