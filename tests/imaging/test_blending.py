"""Blending in frequency bands and in the gradient domain: what fits stays as it is, steps are spread, and what is unknown has no effect."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.imaging.blending import Layer, blend_bands, find_links, solve_screened_poisson

SHAPES = st.tuples(st.integers(1, 70), st.integers(1, 70))


class TestBands:
    """Multi-resolution splines."""

    @given(SHAPES, st.integers(1, 5), st.integers(0, 999))
    @settings(max_examples=15, deadline=None)
    def test_one_image_comes_back_where_it_is_known(self, shape, levels, seed):
        random = np.random.default_rng(seed)
        known = random.random(shape) < 0.6
        image = random.random((*shape, 3), np.float32)
        result = blend_bands([Layer(image, known, known.astype(np.float32))], image.shape, levels)
        assert result[known] == pytest.approx(image[known], abs=1e-5)

    @given(SHAPES, st.integers(0, 999))
    @settings(max_examples=15, deadline=None)
    def test_equal_images_are_their_blend(self, shape, seed):
        random = np.random.default_rng(seed)
        image, fraction = random.random((*shape, 3), np.float32), random.random(shape, np.float32)
        known = np.ones(shape, bool)
        result = blend_bands([Layer(image, known, fraction), Layer(image, known, 1.0 - fraction)], image.shape, 4)
        assert result == pytest.approx(image, abs=1e-5)

    def test_a_step_becomes_a_ramp_as_wide_as_the_coarsest_band(self):
        shape, left = (40, 256), np.zeros((40, 256), np.float32)
        left[:, :128] = 1.0
        known = np.ones(shape, bool)
        layers = [Layer(np.full((*shape, 3), value, np.float32), known, fraction) for value, fraction in ((0.2, left), (0.8, 1.0 - left))]
        widths = []
        for levels in (1, 3, 5):
            row = blend_bands(layers, (*shape, 3), levels)[20, :, 0]
            assert row[0] == pytest.approx(0.2, abs=1e-4) and row[-1] == pytest.approx(0.8, abs=1e-4)
            assert (np.diff(row) > -1e-3).all()
            widths.append(np.count_nonzero((row > 0.25) & (row < 0.75)))
        assert widths[0] == 0 < 4 * widths[1] / 3 < widths[2]

    def test_details_do_not_cross_the_border(self):
        """A fine pattern of one half appears in the other only within a few pixels, although colors blend over dozens."""
        shape = (64, 256)
        columns = np.arange(256)
        pattern = np.broadcast_to((0.5 + 0.3 * (-1.0) ** columns)[None, :, None], (*shape, 1)).astype(np.float32)
        left = np.broadcast_to(columns < 128, shape).astype(np.float32)
        known = np.ones(shape, bool)
        layers = [Layer(pattern, known, left), Layer(np.full_like(pattern, 0.5), known, 1.0 - left)]
        row = blend_bands(layers, (*shape, 1), 5)[32, :, 0]
        assert np.abs(row[136:] - 0.5).max() < 0.02 and np.abs(row[:120] - pattern[32, :120, 0]).max() < 0.02

    def test_unknown_pixels_have_no_effect(self):
        random = np.random.default_rng(4)
        known = np.zeros((50, 60), bool)
        known[10:40, 5:30] = True
        fraction = (known & (np.arange(60) < 20)).astype(np.float32)
        first, second = (random.random((50, 60, 2), np.float32) for _ in range(2))
        garbage = np.where(known[..., None], first, np.float32(1e3))
        everywhere = np.ones((50, 60), bool)
        results = [
            blend_bands([Layer(image, known, fraction), Layer(second, everywhere, 1.0 - fraction)], first.shape, 4)
            for image in (first, garbage)
        ]
        assert np.array_equal(*results)


class TestPoisson:
    """Screened Poisson equations."""

    def test_an_image_with_its_own_gradients_stays(self):
        random = np.random.default_rng(1)
        used = random.random((30, 40)) < 0.7
        colors = random.random((np.count_nonzero(used), 3))
        links = find_links(used)
        result = solve_screened_poisson(links, colors[links.second] - colors[links.first], colors, 20.0)
        assert result == pytest.approx(colors, abs=1e-3)

    def test_a_step_that_the_gradients_do_not_have_is_spread(self):
        used = np.ones((20, 200), bool)
        colors = np.repeat((np.arange(200) >= 100)[None, :] * 0.5, 20, axis=0).reshape(-1, 1)
        links = find_links(used)
        for length in (5.0, 20.0):
            row = solve_screened_poisson(links, np.zeros((len(links.first), 1)), colors, length).reshape(20, 200)[10]
            assert row[[0, -1]] == pytest.approx([0.0, 0.5], abs=0.01)
            expected = 0.25 * np.exp((np.arange(100) - 99.5) / length)  # The solution of the equation on a line.
            assert row[:100] == pytest.approx(expected, abs=0.01)

    def test_parts_that_are_not_linked_do_not_influence_each_other(self):
        used = np.ones((12, 21), bool)
        used[:, 10] = False
        values = np.where(np.argwhere(used)[:, 1] < 10, 0.2, 0.9)[:, None]
        links = find_links(used)
        assert solve_screened_poisson(links, np.zeros((len(links.first), 1)), values, 1000.0) == pytest.approx(values, abs=1e-3)
