"""Gains of texels that make the sums of a level those of its source."""

import numpy as np
import pytest

from farfield.addon.core.billboards.luminance_gains import MAX_GAIN, TOLERANCE, compute_gains

QUADS = np.where(np.arange(40)[None] < 20, 0, 1) * np.ones((30, 1), np.int64)
QUADS[:, 19] = -1
TEXELS = np.flatnonzero(QUADS.ravel() >= 0).repeat(4)


def test_equal_images_change_nothing():
    noise = 1.0 + 0.5 * TOLERANCE * np.random.default_rng(0).uniform(-1.0, 1.0, len(TEXELS))
    assert (compute_gains(TEXELS, noise, np.ones(len(TEXELS)), QUADS) == 1.0).all()
    assert (compute_gains(TEXELS[:0], noise[:0], noise[:0], QUADS) == 1.0).all()


def test_each_quad_gets_its_own_gain():
    wanted = np.where(QUADS.ravel()[TEXELS] == 0, 0.5, 1.2)
    gains = compute_gains(TEXELS, wanted, np.ones(len(TEXELS)), QUADS)
    for quad, gain in ((0, 0.5), (1, 1.2)):
        assert gains[quad == QUADS] == pytest.approx(gain, abs=0.02)
    assert (gains[QUADS < 0] == 1.0).all()


def test_gains_follow_gradients_within_a_quad():
    wanted = 0.4 + 0.6 * (TEXELS // 40) / 29.0
    gains = compute_gains(TEXELS, wanted, np.ones(len(TEXELS)), QUADS)
    assert gains[2, 10] < 0.65 and gains[27, 10] > 0.8
    assert (gains.ravel()[TEXELS]).sum() == pytest.approx(wanted.sum(), rel=0.01)


def test_quads_that_nobody_saw_get_the_mean():
    seen = TEXELS[QUADS.ravel()[TEXELS] == 0]
    gains = compute_gains(seen, np.full(len(seen), 0.6), np.ones(len(seen)), QUADS)
    assert gains[QUADS == 1] == pytest.approx(0.6, abs=1e-6)


def test_gains_are_limited():
    assert (compute_gains(TEXELS, np.full(len(TEXELS), 9.0), np.ones(len(TEXELS)), QUADS)[QUADS >= 0] == MAX_GAIN).all()
