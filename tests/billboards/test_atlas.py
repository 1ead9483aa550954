"""Quads find places of their own in one texture, and a quad takes the texels that its area asks for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.billboards.atlas import GUTTER, LARGEST, MULTIPLE, pack, skyline
from farfield.addon.core.errors import SettingsError

sizes = st.lists(st.tuples(st.integers(1, 60), st.integers(1, 60)), min_size=1, max_size=40)


@settings(max_examples=60)
@given(sizes, st.sampled_from([1e-6, 0.37, 1.0, 1e6]), st.integers(0, 8))
def test_no_two_come_nearer_than_the_gutter_and_all_are_inside(sides, texel, gutter):
    atlas = pack(0.5 * texel * np.array(sides, float), texel, gutter)
    width, height = atlas.size
    np.testing.assert_array_equal(atlas.rectangles[:, 2:], sides)
    assert width % MULTIPLE == 0 and height % MULTIPLE == 0
    taken = np.zeros((height + gutter, width + gutter), np.int32)
    for x, y, wide, tall in atlas.rectangles:
        assert x >= gutter and y >= gutter and x + wide <= width - gutter and y + tall <= height - gutter
        taken[y : y + tall + gutter, x : x + wide + gutter] += 1  # its own texels and the gutter above and to its right
    assert taken.max() == 1
    assert atlas.texels == sum(wide * tall for wide, tall in sides)


@given(sizes)
def test_places_in_a_strip_do_not_overlap(sides):
    padded = np.array(sides)
    places, height = skyline(padded, 64)
    taken = np.zeros((height, 64), np.int32)
    for (x, y), (wide, tall) in zip(places, padded, strict=True):
        taken[y : y + tall, x : x + wide] += 1
    assert taken.max() == 1
    assert taken.sum() == padded.prod(axis=1).sum()
    assert taken[-1].any()


@given(st.floats(0.01, 30.0), st.floats(0.01, 30.0), st.floats(0.1, 2.0))
def test_a_side_is_its_length_in_texels(wide, tall, texel):
    atlas = pack(0.5 * np.array([[wide, tall]]), texel)
    for texels, length in zip(atlas.rectangles[0, 2:], (wide, tall), strict=True):
        assert texels == 1 or abs(texels - length / texel) <= 0.5 + 1e-9
        assert texels >= 1


def test_rounding_takes_no_side():
    """Over many quads the texels are the area."""
    half_sizes = np.random.default_rng(0).uniform(1.0, 12.0, (2000, 2))
    assert pack(half_sizes, 1.0).texels == pytest.approx(4.0 * half_sizes.prod(axis=1).sum(), rel=0.01)


def test_little_is_wasted():
    half_sizes = np.random.default_rng(1).uniform(2.0, 20.0, (300, 2))
    atlas = pack(half_sizes, 1.0)
    padded = (atlas.rectangles[:, 2:] + GUTTER).astype(float).prod(axis=1).sum()
    assert atlas.size[0] * atlas.size[1] <= 1.25 * padded
    assert 0.7 <= atlas.size[0] / atlas.size[1] <= 1.5


def test_more_than_a_texture_holds_is_refused():
    for half_sizes in ([[LARGEST, 1.0]], [[1.0, LARGEST]], [[1e7, 1e7]] * 3, [[4000.0, 4000.0]] * 9):
        with pytest.raises(SettingsError, match=f"{LARGEST} is the largest side"):
            pack(np.array(half_sizes), 1.0)
