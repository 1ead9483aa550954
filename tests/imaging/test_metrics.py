"""Metrics have known values: by definition on simple images, and from the reference implementation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.imaging import metrics

SEEDS = st.integers(0, 2**32 - 1)


def waves(height: int, width: int) -> np.ndarray:
    row, column = np.mgrid[:height, :width] / (width - 1)
    return 0.5 + 0.5 * np.sin(20.0 * column + 9.0 * row)


def noisy_pair(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(7)
    image = random.random(shape)
    return image, np.clip(image + random.normal(0.0, 0.1, shape), 0.0, 1.0)


def test_ssim_agrees_with_scikit_image():
    """Values of structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1), version 0.26."""
    assert metrics.ssim(*noisy_pair((32, 40))) == pytest.approx(0.944799130942082, abs=1e-6)
    assert metrics.ssim(*noisy_pair((32, 40, 3))) == pytest.approx(0.9458467954902718, abs=1e-6)
    image = waves(33, 48)
    changed = 0.8 * image + 0.1 * np.mgrid[:33, :48][0] / 47.0
    assert metrics.ssim(image, changed) == pytest.approx(0.965866420961256, abs=1e-6)


def test_ssim_is_one_only_for_equal_images():
    image = waves(24, 24)
    assert metrics.ssim(image, image) == pytest.approx(1.0, abs=1e-12)
    assert metrics.ssim(image, 1.0 - image) < 0.0


def test_ssim_of_constant_images_is_the_luminance_term():
    dark, bright = np.full((16, 16), 0.2), np.full((16, 16), 0.6)
    expected = (2.0 * 0.2 * 0.6 + 1e-4) / (0.2**2 + 0.6**2 + 1e-4)
    assert metrics.ssim(dark, bright) == pytest.approx(expected, rel=1e-9)


@given(SEEDS)
def test_ssim_is_symmetric_and_bounded(seed):
    first, second = np.random.default_rng(seed).random((2, 14, 17, 3))
    assert metrics.ssim(first, second) == pytest.approx(metrics.ssim(second, first), abs=1e-12)
    assert -1.0 <= metrics.ssim(first, second) <= 1.0


def test_ssim_rejects_small_images_and_different_shapes():
    with pytest.raises(ValueError, match="11 pixels"):
        metrics.ssim(np.zeros((10, 40)), np.zeros((10, 40)))
    with pytest.raises(ValueError, match="same shape"):
        metrics.ssim(np.zeros((20, 20)), np.zeros((20, 21)))


def test_psnr_of_a_known_difference():
    image = np.full((8, 8, 3), 0.5)
    assert metrics.psnr(image, image + 0.1) == pytest.approx(20.0)
    assert metrics.psnr(image, image) == float("inf")


def test_overlap_of_shifted_squares():
    first, second = np.zeros((2, 30, 30))
    first[5:15, 5:15] = 1.0
    second[5:15, 10:20] = 1.0
    assert metrics.alpha_iou(first, second) == pytest.approx(50.0 / 150.0)
    assert metrics.alpha_iou(first, 0.5 * first) == pytest.approx(0.5)
    assert metrics.alpha_iou(np.zeros((4, 4)), np.zeros((4, 4))) == 1.0


@given(st.floats(0.0, 1.0))
def test_srgb_round_trip(value):
    assert metrics.decode_srgb(metrics.encode_srgb(np.float64(value))) == pytest.approx(value, abs=1e-6)
    assert metrics.encode_srgb(metrics.decode_srgb(np.float64(value))) == pytest.approx(value, abs=1e-6)


def test_composite_shows_the_background_where_alpha_is_zero_and_the_render_where_it_is_one():
    render = np.zeros((1, 3, 4))
    render[0, 1] = [0.25, 0.5, 2.0, 1.0]
    render[0, 2] = [0.0, 0.0, 0.0, 0.5]
    image = metrics.composite_over_gray(render)
    assert image[0, 0] == pytest.approx([0.5, 0.5, 0.5], abs=1e-9)
    assert image[0, 1] == pytest.approx([0.5371, 0.7354, 1.0], abs=1e-4)
    assert image[0, 2] == pytest.approx(np.full(3, 0.361), abs=1e-3)  # half the light of the background, not half its sRGB value


def test_crop_contains_the_object_and_its_margin_within_the_image():
    alpha = np.zeros((40, 50))
    alpha[10:20, 2:30] = 1.0
    rows, columns = metrics.crop_to_object(alpha, margin=5)
    assert (rows.start, rows.stop, columns.start, columns.stop) == (5, 25, 0, 35)
    assert alpha[rows, columns].sum() == alpha.sum()
    with pytest.raises(ValueError, match="empty"):
        metrics.crop_to_object(np.zeros((4, 4)))
