"""Rays meet the quads that lie under them, nearest first, where the texture says."""

import numpy as np
import pytest
from hypothesis import given, settings
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


def brute_force(quads: Quads, view: View) -> list[tuple[int, int]]:
    """Ray and quad of every crossing, by half planes one by one."""
    found = []
    for number, corners in enumerate(quads.corners):
        outline = view.project(corners)[0]
        following = np.roll(outline, -1, axis=0)
        turn = np.sign((outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum())
        for ray in range(view.side**2):
            to_ray = np.array([ray % view.side, ray // view.side]) + 0.5 - outline
            along = following - outline
            if (turn * (along[:, 0] * to_ray[:, 1] - along[:, 1] * to_ray[:, 0]) >= 0.0).all():
                found.append((ray, number))
    return sorted(found)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_outlines_of_any_number_of_corners_are_met_where_they_are(seed):
    """Polygons of three to six corners, partly outside the picture, against half planes one by one."""
    random = np.random.default_rng(seed)
    corners, coordinates = [], []
    for number, count in enumerate((3, 6, 4, 5)):
        turn = np.sort(random.uniform(0.0, 2.0 * np.pi, count))
        flat = np.column_stack([np.cos(turn), np.sin(turn)]) * random.uniform(0.5, 5.0, 2)
        corners.append(np.column_stack([flat + random.uniform(0.0, 8.0, 2), np.full(count, float(number))]))
        coordinates.append(flat + [6.0 + 12.0 * number, 6.0])
    quads = Quads(corners, coordinates)
    texels, view = texels_of(quads, (50, 12)), seen_from((0.2, 0.1, 1.0), 13)
    found = fragments_of(quads, texels, view, 1)
    owners = texels.quads[found.texels[np.arange(len(found)), found.shares.argmax(axis=1)]]
    assert sorted(zip(found.ray.tolist(), owners.tolist(), strict=True)) == brute_force(quads, view)


@pytest.mark.parametrize("cosine", [1e-9, 1e-8, 1e-6, 1e-3])
def test_quads_seen_nearly_from_their_edge_keep_their_places(cosine):
    """A slanting quad that is a thin line in the picture, its middle on the middle of a pixel."""
    along, up = np.array([0.8, 0.6, 0.0]), np.array([-0.6, 0.8, 0.0])
    side = cosine * up + np.array([0.0, 0.0, 1.0])
    middle = np.array([4.5, 4.5, 0.0])
    sides = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    quads = Quads([middle + 3.0 * sides[:, :1] * along + 3.0 * sides[:, 1:] * side], [3.0 * sides + 5.0])
    texels = texels_of(quads, SIZE)
    found = fragments_of(quads, texels, View(np.array([0.0, 0.0, 1.0]), np.array([4.0, 4.0, 0.0]), 8, 1.0), 1)
    assert np.isfinite(found.shares).all()
    if len(found):
        shown = (texels.pixels[found.texels] * found.shares[..., None]).sum(axis=1) / found.shares.sum(axis=1, keepdims=True) + 0.5
        row, column = np.divmod(found.ray, 8)
        where = (np.column_stack([column, row]) + 0.5 - middle[:2]) @ along[:2] + 5.0
        np.testing.assert_allclose(np.clip(shown[:, 0], 2.5, 7.5), np.clip(where, 2.5, 7.5), atol=0.01)


def test_no_quads_are_met_nowhere():
    assert len(fragments_of(Quads([], []), texels_of(two_sheets(), SIZE), seen_from((0, 0, 1)), 2)) == 0


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
