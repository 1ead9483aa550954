"""Pyramids keep constants and straight lines, and weights decide which samples count."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.imaging.pyramids import reduce_image, reduce_mask, reduce_weighted


@settings(max_examples=30)
@given(st.integers(1, 20), st.integers(1, 20), st.floats(-10, 10, width=32), st.booleans(), st.booleans())
def test_constants_stay_at_half_the_size(height, width, value, wrap_rows, wrap_columns):
    reduced = reduce_image(np.full((height, width, 2), value, np.float32), (wrap_rows, wrap_columns))
    assert reduced.shape == ((height + 1) // 2, (width + 1) // 2, 2)
    assert np.allclose(reduced, value, atol=1e-5)


def test_sample_positions_are_those_of_even_samples():
    ramp = np.arange(21, dtype=np.float32)[:, None, None] * np.ones((1, 21, 1), np.float32)
    assert reduce_image(ramp)[1:-1, :, 0] == pytest.approx(ramp[2:-2:2, ::2, 0], abs=1e-5)


def test_the_kernel_is_that_of_the_paper():
    impulse = np.zeros((9, 9, 1), np.float32)
    impulse[4, 4] = 1.0
    row = np.float32([0.05, 0.4, 0.05])
    assert reduce_image(impulse)[1:4, 1:4, 0] == pytest.approx(np.outer(row, row), abs=1e-7)


def test_a_mask_grows_by_every_pixel_that_the_kernel_touches():
    mask = np.zeros((17, 17), bool)
    mask[8, 8] = True
    assert reduce_mask(mask).sum() == 9 and reduce_mask(mask)[3:6, 3:6].all()
    assert not reduce_mask(np.zeros((5, 5), bool)).any()


def test_samples_without_weight_do_not_count():
    random = np.random.default_rng(1)
    weights = (random.random((16, 16)) < 0.6).astype(np.float32)
    image = np.where(weights[..., None] > 0.0, np.float32(0.75), np.float32(1e9))
    reduced, weight = reduce_weighted(image * np.ones((1, 1, 3), np.float32), weights)
    assert np.allclose(reduced[weight > 0.0], 0.75) and (reduced[weight == 0.0] == 0.0).all()
    assert np.allclose(weight, reduce_image(weights), atol=1e-6)
