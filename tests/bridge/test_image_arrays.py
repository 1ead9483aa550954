"""Dilation keeps what is known and fills the rest; mips keep means; coverage survives an alpha test."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.images import dilate, grow_outline, mips, preserve_coverage, unpremultiply


@settings(max_examples=40)
@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.02, 0.9), st.integers(0, 2**32 - 1))
def test_dilation_keeps_the_known_and_invents_nothing(height, width, share, seed):
    random = np.random.default_rng(seed)
    image = random.random((height, width, 3), np.float32)
    known = random.random((height, width)) < share
    filled = dilate(image, known)
    assert (filled[known] == image[known]).all()
    if known.any():
        assert np.isfinite(filled).all()
        assert (filled >= image[known].min(axis=0) - 1e-5).all() and (filled <= image[known].max(axis=0) + 1e-5).all()


def test_two_charts_keep_their_colours_up_to_the_middle_of_the_gutter():
    image, known = np.zeros((12, 20, 1), np.float32), np.zeros((12, 20), bool)
    known[:, :8], known[:, 12:] = True, True
    image[:, 12:] = 1.0
    filled = dilate(image, known, 2)
    assert (filled[:, :10] == 0.0).all() and (filled[:, 10:] == 1.0).all()


def test_an_image_with_nothing_known_stays():
    image = np.full((3, 5, 2), 7.0, np.float32)
    assert dilate(image, np.zeros((3, 5))) is image


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (16, 4), (32, 1)])
def test_mips_of_powers_of_two_keep_the_mean(size):
    image = np.random.default_rng(1).random((*size, 4), np.float32)
    chain = mips(image)
    assert chain[-1].shape == (1, 1, 4)
    for level in chain:
        assert level.mean(axis=(0, 1)) == pytest.approx(image.mean(axis=(0, 1)), abs=1e-5)


def test_leaves_pass_the_alpha_test_as_often_in_every_mip():
    leaves = np.random.default_rng(2).random((256, 256)) ** 4.0
    chain = [level[..., 0] for level in mips(leaves[..., None].astype(np.float32))][:5]
    coverage = float((chain[0] > 0.5).mean())
    assert coverage > 0.1
    assert (chain[3] > 0.5).mean() < 0.01, "without help the leaves vanish"
    for level in preserve_coverage(chain):
        assert (level > 0.5).mean() == pytest.approx(coverage, abs=1.5 / level.size)


def test_premultiplied_colours_come_back_straight():
    straight = np.random.default_rng(3).random((4, 4, 4), np.float32)
    straight[0, :, 3] = 0.0
    premultiplied = straight.copy()
    premultiplied[..., :3] *= straight[..., 3:]
    back = unpremultiply(premultiplied)
    assert back[1:] == pytest.approx(straight[1:], abs=1e-5)
    assert (back[0] == 0.0).all()


def test_grown_outlines_reach_one_texel_farther_where_asked_and_nowhere_else():
    image = np.zeros((8, 8, 4), np.float32)
    image[3:5, 2:5] = [0.2, 0.4, 0.6, 1.0]
    image[6, 6] = [0.1, 0.0, 0.0, 0.5]
    left = np.zeros((8, 8), bool)
    left[:, :5] = True
    grown = grow_outline(image, left, 3)
    expected = image[..., 3].copy()
    expected[2, 2:5] = expected[5, 2:5] = expected[3:5, 1] = 1.0
    np.testing.assert_array_equal(grown[..., 3], expected)
    np.testing.assert_allclose(grown[2, 3], [0.2, 0.4, 0.6, 1.0], atol=1e-6)
    np.testing.assert_allclose(grown[~left], image[~left], atol=1e-6)
