"""Tests of the atlas: rectangles do not overlap, and the number of texels follows from the area of the quads."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.billboards.atlas import MAX_SIDE, MAX_TEXELS, MIP_SIZES, SIZE_MULTIPLE, pack, pack_skyline
from farfield.addon.core.errors import SettingsError

sizes = st.lists(st.tuples(st.integers(1, 60), st.integers(1, 60)), min_size=1, max_size=40)


def filter_range(center, extent, mip_level, count):
    """Return the first and the last texel of a `mip_level` that a bilinear filter reads on an interval, clamped to `count` texels."""
    ends = np.array([center - 0.5 * extent, center + 0.5 * extent]) / 2**mip_level
    return max(int(np.floor(ends[0] - 0.5 + 1e-9)), 0), min(int(np.ceil(ends[1] - 0.5 - 1e-9)), count - 1)


@settings(max_examples=60)
@given(sizes, st.sampled_from([1e-6, 0.37, 1.0, 1e6]))
def test_bilinear_filters_read_texels_of_their_own_quad_only(sides, texel_size):
    """Also in the first mip levels, in which large quads are separate: their texels are means of texels of one rectangle."""
    atlas = pack(0.5 * texel_size * np.array(sides, float), texel_size)
    assert all(side % SIZE_MULTIPLE == 0 for side in atlas.size)
    np.testing.assert_array_equal(atlas.quad_sizes, sides)
    usage = np.zeros(atlas.size[::-1], np.int32)
    for quad, (x, y, wide, tall) in enumerate(atlas.rectangles):
        assert x >= 0 and y >= 0 and x + wide <= atlas.size[0] and y + tall <= atlas.size[1]
        usage[y : y + tall, x : x + wide] += 1
        for mip_level in range(1 + sum(min(sides[quad]) >= size for size in MIP_SIZES)):
            for axis in (0, 1):
                start, extent = atlas.rectangles[quad, axis], atlas.rectangles[quad, 2 + axis]
                low, high = filter_range(start + 0.5 * extent, sides[quad][axis], mip_level, atlas.size[axis] >> mip_level)
                assert start <= low << mip_level and (high + 1) << mip_level <= start + extent
    assert usage.max() == 1
    np.testing.assert_array_equal(usage > 0, atlas.quad_map >= 0)
    assert atlas.texel_count == sum(wide * tall for wide, tall in sides)


@given(sizes)
def test_rectangles_in_a_strip_do_not_overlap(sides):
    padded = np.array(sides)
    positions, height = pack_skyline(padded, np.ones(len(padded), int), 64)
    usage = np.zeros((height, 64), np.int32)
    for (x, y), (wide, tall) in zip(positions, padded, strict=True):
        usage[y : y + tall, x : x + wide] += 1
    assert usage.max() == 1
    assert usage.sum() == padded.prod(axis=1).sum()
    assert usage[-1].any()


@given(st.floats(0.01, 30.0), st.floats(0.01, 30.0), st.floats(0.1, 2.0))
def test_side_is_its_length_in_texels(wide, tall, texel_size):
    atlas = pack(0.5 * np.array([[wide, tall]]), texel_size)
    for texels, length in zip(atlas.quad_sizes[0], (wide, tall), strict=True):
        assert texels == 1 or abs(texels - length / texel_size) <= 0.5 + 1e-9
        assert texels >= 1


def test_rounding_is_unbiased():
    """Over many quads the number of texels matches the area."""
    half_sizes = np.random.default_rng(0).uniform(1.0, 12.0, (2000, 2))
    assert pack(half_sizes, 1.0).texel_count == pytest.approx(4.0 * half_sizes.prod(axis=1).sum(), rel=0.01)


@pytest.mark.parametrize("count", [30, 100, 300])
@pytest.mark.parametrize("texels", [6.0, 8.0, 14.0, 40.0])
def test_most_of_the_atlas_is_used(texels, count):
    """Quads of a few texels are a coarse level."""
    half_sizes = 0.5 * texels * np.random.default_rng(1).lognormal(0.0, 0.6, (count, 2))
    atlas = pack(half_sizes, 1.0)
    assert atlas.texel_count >= 0.65 * atlas.size[0] * atlas.size[1]
    assert 0.5 <= atlas.size[0] / atlas.size[1] <= 2.0


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
