"""Tests of the atlas: rectangles do not overlap, and the number of texels follows from the area of the quads."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.billboards.atlas import GUTTER, MAX_SIDE, MAX_TEXELS, SIZE_MULTIPLE, pack, pack_skyline
from farfield.addon.core.errors import SettingsError

sizes = st.lists(st.tuples(st.integers(1, 60), st.integers(1, 60)), min_size=1, max_size=40)


@settings(max_examples=60)
@given(sizes, st.sampled_from([1e-6, 0.37, 1.0, 1e6]), st.integers(0, 8))
def test_rectangles_keep_the_gutter_and_are_inside(sides, texel_size, gutter):
    atlas = pack(0.5 * texel_size * np.array(sides, float), texel_size, gutter)
    width, height = atlas.size
    np.testing.assert_array_equal(atlas.rectangles[:, 2:], sides)
    assert width % SIZE_MULTIPLE == 0 and height % SIZE_MULTIPLE == 0
    usage = np.zeros((height + gutter, width + gutter), np.int32)
    for x, y, wide, tall in atlas.rectangles:
        assert x >= gutter and y >= gutter and x + wide <= width - gutter and y + tall <= height - gutter
        usage[y : y + tall + gutter, x : x + wide + gutter] += 1  # the texels and the gutter above and to the right
    assert usage.max() == 1
    assert atlas.texel_count == sum(wide * tall for wide, tall in sides)


@given(sizes)
def test_rectangles_in_a_strip_do_not_overlap(sides):
    padded = np.array(sides)
    positions, height = pack_skyline(padded, 64)
    usage = np.zeros((height, 64), np.int32)
    for (x, y), (wide, tall) in zip(positions, padded, strict=True):
        usage[y : y + tall, x : x + wide] += 1
    assert usage.max() == 1
    assert usage.sum() == padded.prod(axis=1).sum()
    assert usage[-1].any()


@given(st.floats(0.01, 30.0), st.floats(0.01, 30.0), st.floats(0.1, 2.0))
def test_side_is_its_length_in_texels(wide, tall, texel_size):
    atlas = pack(0.5 * np.array([[wide, tall]]), texel_size)
    for texels, length in zip(atlas.rectangles[0, 2:], (wide, tall), strict=True):
        assert texels == 1 or abs(texels - length / texel_size) <= 0.5 + 1e-9
        assert texels >= 1


def test_rounding_is_unbiased():
    """Over many quads the number of texels matches the area."""
    half_sizes = np.random.default_rng(0).uniform(1.0, 12.0, (2000, 2))
    assert pack(half_sizes, 1.0).texel_count == pytest.approx(4.0 * half_sizes.prod(axis=1).sum(), rel=0.01)


def test_packing_wastes_little():
    half_sizes = np.random.default_rng(1).uniform(2.0, 20.0, (300, 2))
    atlas = pack(half_sizes, 1.0)
    padded = (atlas.rectangles[:, 2:] + GUTTER).astype(float).prod(axis=1).sum()
    assert atlas.size[0] * atlas.size[1] <= 1.25 * padded
    assert 0.7 <= atlas.size[0] / atlas.size[1] <= 1.5


def test_rejects_more_than_fits_into_a_texture():
    for half_sizes in ([[MAX_SIDE, 1.0]], [[1.0, MAX_SIDE]], [[1e7, 1e7]] * 3, [[4000.0, 4000.0]] * 9):
        with pytest.raises(SettingsError, match=f"the largest side is {MAX_SIDE}"):
            pack(np.array(half_sizes), 1.0)


def test_rejects_more_texels_than_memory_holds():
    """A render of 12008 x 14552 texels of a plane with 25 vertices took 20 GB."""
    side = 4000
    assert side**2 < MAX_TEXELS
    assert pack(np.array([[0.5 * side, 0.5 * side]]), 1.0).texel_count == side**2
    for half_sizes in ([[side, side]], [[0.2 * side, 0.2 * side]] * 9, [[0.45 * MAX_SIDE, 600.0]]):
        with pytest.raises(SettingsError, match=r"the limit is 16.8 million; use a larger Error or Texel Size"):
            pack(np.array(half_sizes), 1.0)
