"""The split into structure and texture is exact, and kappa follows the homogeneity of the texture."""

import numpy as np
import pytest
from scipy.fft import dctn, idctn

from farfield.addon.core.restore.frequency_split import (
    MAX_AUTO_SUB_BANDS,
    MAX_DEVIATION,
    LowBand,
    autocorrelation_deviations,
    choose_sub_bands,
    luminance,
)


def noise(shape, seed=0, amplitude=0.05):
    return (0.5 + amplitude * np.random.default_rng(seed).standard_normal(shape)).astype(np.float32)


def gradient(height, width):
    y, x = np.mgrid[:height, :width]
    return (0.5 * np.sin(3.0 * x / width) * np.cos(2.5 * y / height))[..., None].astype(np.float32)


@pytest.mark.parametrize("shape", [(24, 24, 3), (17, 30, 1)])
class TestLowBand:
    """The projection of an image to its lowest sub-bands."""

    def test_no_sub_band_is_zero(self, shape):
        low = LowBand(noise(shape), 0).evaluate(np.arange(shape[0]), np.arange(shape[1]))
        assert low.shape == shape and (low == 0.0).all()

    def test_all_sub_bands_are_the_image(self, shape):
        image = noise(shape)
        assert np.allclose(LowBand(image, max(shape)).evaluate(np.arange(shape[0]), np.arange(shape[1])), image, atol=1e-5)

    def test_it_holds_the_lowest_coefficients(self, shape):
        image, kappa = noise(shape), 5
        expected = dctn(image, axes=(0, 1), norm="ortho")
        expected[kappa:], expected[:, kappa:] = 0.0, 0.0
        low = LowBand(image, kappa)
        everywhere = low.evaluate(np.arange(shape[0]), np.arange(shape[1]))
        assert np.allclose(everywhere, idctn(expected, axes=(0, 1), norm="ortho"), atol=1e-5)
        rows, columns = np.array([3, 9, 1]), np.array([11, 2])
        assert np.allclose(low.evaluate(rows, columns), everywhere[np.ix_(rows, columns)], atol=1e-6)


class TestKappa:
    """The automatic number of sub-bands."""

    def test_both_ways_to_the_deviation_agree(self):
        values = noise((32, 32)) + gradient(32, 32)[..., 0]
        deviations = list(autocorrelation_deviations(values))[:6]
        for kappa, deviation in enumerate(deviations):
            coefficients = dctn(values, norm="ortho")
            coefficients[:kappa, :kappa] = 0.0
            texture = idctn(coefficients, norm="ortho")
            correlation = idctn(dctn(texture, norm="ortho") ** 2, norm="ortho") / (2.0 * 32)
            assert deviation == pytest.approx(correlation.std(), rel=1e-4, abs=1e-8)

    @pytest.mark.parametrize("shape", [(40, 40), (24, 40)])
    def test_more_structure_leaves_a_more_homogeneous_texture(self, shape):
        deviations = np.array(list(autocorrelation_deviations(noise(shape) + gradient(*shape)[..., 0])))
        assert len(deviations) == 41 and deviations[-1] == pytest.approx(0.0, abs=1e-12)
        if shape[0] == shape[1]:
            assert (np.diff(deviations) <= 1e-12).all()

    def test_the_deviation_of_noise_does_not_depend_on_the_size(self):
        scaled = [next(autocorrelation_deviations(noise((size, size)))) * size for size in (64, 256)]
        assert scaled[0] == pytest.approx(scaled[1], rel=0.1)

    def test_noise_alone_has_no_structure(self):
        kappa, deviations = choose_sub_bands(noise((96, 96, 3)), is_color=True)
        assert kappa == 0 and len(deviations) == MAX_AUTO_SUB_BANDS + 1

    @pytest.mark.parametrize("contrast", [0.2, 0.5, 1.0])
    def test_a_strong_pattern_is_no_structure(self, contrast):
        y, x = np.mgrid[:120, :160] // 7
        pattern = 0.5 + contrast * ((x + y) % 2 - 0.5)
        assert choose_sub_bands(pattern[..., None].astype(np.float32), is_color=False)[0] <= 1

    def test_a_gradient_is_structure(self):
        kappa, deviations = choose_sub_bands(np.clip(noise((96, 120, 3)) + gradient(96, 120), 0.0, 1.0), is_color=True)
        assert 1 <= kappa <= 6
        assert deviations[kappa] < MAX_DEVIATION and (deviations[:kappa] >= MAX_DEVIATION).all()

    @pytest.mark.slow
    def test_the_choice_hardly_depends_on_the_size(self):
        small, _ = choose_sub_bands(gradient(128, 128) + 0.5, is_color=False)
        large, _ = choose_sub_bands(gradient(2048, 2048) + 0.5, is_color=False)
        assert abs(small - large) <= 1


def test_luminance_is_that_of_cie_y():
    colors = np.float32([[[1.0, 1.0, 1.0], [0.5, 0.5, 0.5], [0.0, 1.0, 0.0]]])
    assert luminance(colors, is_color=True)[0] == pytest.approx([1.0, 0.2140, 0.7152], abs=1e-3)
    assert luminance(colors, is_color=False)[0] == pytest.approx([1.0, 0.5, 1.0 / 3.0])
    assert luminance(colors[..., :1], is_color=True)[0] == pytest.approx([1.0, 0.5, 0.0])
