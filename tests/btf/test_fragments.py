"""Rays meet the quads that lie under them, nearest first, where the texture says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.btf.fragments import Fragments, fragments_of
from farfield.addon.core.btf.texels import Quads, View, texels_of

SIZE = (20, 12)


def two_sheets(upper: float = 2.0) -> Quads:
    """A sheet of 8 x 8 units, a texel each, and beside it in the texture another one, `upper` above its right half."""
    flat = np.array([[0, 0], [8, 0], [8, 8], [0, 8]], float)
    narrow = np.array([[4, 0], [8, 0], [8, 8], [4, 8]], float)
    lifted = np.column_stack([narrow, np.full(4, upper)])
    return Quads([np.column_stack([flat, np.zeros(4)]), lifted], [flat + [1.0, 1.0], narrow + [7.0, 1.0]])


def seen_from(direction, side: int = 8) -> View:
    direction = np.array(direction, float)
    return View(direction / np.linalg.norm(direction), np.array([4.0, 4.0, 0.0]), side, 8.0 / side)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1)])
def test_every_ray_meets_what_lies_under_it(direction):
    quads = two_sheets()
    texels = texels_of(quads, SIZE)
    found = fragments_of(quads, texels, seen_from(direction), 2)
    per_pixel = np.bincount(found.ray // 4, minlength=64).reshape(8, 8)
    doubled = slice(4, 8)  # from below too: x is to the right in both
    assert (per_pixel[:, doubled] == 8).all() and per_pixel.sum() == 4 * 64 + 4 * 32
    first = texels.quads[found.texels[found.starts, 0]].reshape(8, 8, 4)
    assert (first[:, doubled] == (1 if direction[2] > 0 else 0)).all()


def test_a_ray_through_the_middle_of_a_texel_takes_it_alone():
    quads = two_sheets()
    texels = texels_of(quads, SIZE)
    found = fragments_of(quads, texels, seen_from((0, 0, 1)), 1)
    ground = np.flatnonzero((texels.quads[found.texels[:, 0]] == 0) & (found.shares.max(axis=1) > 0.999))
    own = found.texels[ground, found.shares[ground].argmax(axis=1)]
    row, column = np.divmod(found.ray[ground], 8)
    np.testing.assert_array_equal(texels.pixels[own] - 1, np.column_stack([column, row]))
    assert len(ground) == 64


def test_taps_stay_within_their_quad():
    quads = two_sheets()
    texels = texels_of(quads, SIZE)
    found = fragments_of(quads, texels, seen_from((0.3, -0.2, 1.0), 24), 2)
    owners = texels.quads[found.texels]
    assert (owners == owners[:, :1]).all()
    assert (found.shares.sum(axis=1) <= 1.0 + 1e-6).all() and (found.shares.sum(axis=1) > 0.0).all()


def test_a_quad_seen_from_its_edge_is_not_met():
    quads = two_sheets()
    texels = texels_of(quads, SIZE)
    assert len(fragments_of(quads, texels, seen_from((1, 0, 0)), 2)) == 0


@given(st.lists(st.lists(st.floats(0.0, 0.999), max_size=5), min_size=1, max_size=6))
def test_light_passes_what_stands_before(alphas):
    """Against the definition, ray by ray; and what all send over what lies behind adds up."""
    ray = np.repeat(np.arange(len(alphas)), [len(each) for each in alphas]).astype(np.int32)
    made = Fragments(len(alphas), ray, np.zeros((len(ray), 4), np.int32), np.zeros((len(ray), 4), np.float32))
    through = made.transmitted(np.concatenate([np.array(each) for each in alphas]))
    expected = np.concatenate([np.cumprod([1.0, *(1.0 - np.array(each))])[:-1] if each else np.zeros(0) for each in alphas])
    np.testing.assert_allclose(through, expected, rtol=1e-4, atol=1e-6)
    sent = np.arange(1.0, len(ray) + 1.0)
    parts = np.split(sent, np.cumsum([len(each) for each in alphas])[:-1])
    behind = np.concatenate([own.sum() - np.cumsum(own) for own in parts])
    np.testing.assert_allclose(made.behind(sent), behind, rtol=1e-5)
