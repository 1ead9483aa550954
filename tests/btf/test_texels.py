"""Texels lie where their quads are, and take from a picture what is theirs."""

import numpy as np
import pytest

from farfield.addon.core.btf import texels as texels_module
from farfield.addon.core.btf.texels import FINER, Belonging, Picture, Quads, View, sight, texels_of

SIZE = (16, 16)


def square(height: float = 0.0, low: int = 4, high: int = 12) -> Quads:
    """One quad over the texels low..high, a unit a texel, `height` above the ground."""
    flat = np.array([[low, low], [high, low], [high, high], [low, high]], float)
    return Quads([np.column_stack([flat, np.full(4, height)])], [flat])


def above(side: int = 16) -> View:
    return View(np.array([0.0, 0.0, 1.0]), np.array([8.0, 8.0, 0.0]), side, 16.0 / side)


def picture(faces: np.ndarray, heights: float = 0.0, colour=(0.2, 0.4, 0.6)) -> Picture:
    seen = faces >= 0
    radiance = seen[None, ..., None] * np.array(colour, np.float32)
    fine = np.kron(faces, np.ones((FINER, FINER))).astype(np.int32)
    return Picture(radiance.astype(np.float32), seen.astype(np.float32), fine, np.where(fine >= 0, heights, -np.inf))


def test_texels_are_where_the_texture_says():
    texels = texels_of(square(3.0), SIZE)
    np.testing.assert_allclose(texels.positions, np.column_stack([texels.pixels + 0.5, np.full(len(texels), 3.0)]), atol=1e-9)
    assert len(texels) >= 64
    assert len(np.unique(texels.pixels, axis=0)) == len(texels)


def test_a_tilted_quad_is_sampled_on_its_plane():
    flat = square()
    turned = flat.corners[0] @ np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]])
    texels = texels_of(Quads([turned], flat.coordinates), SIZE)
    normal = np.cross(turned[1] - turned[0], turned[2] - turned[0])
    assert np.abs((texels.positions - turned[0]) @ normal).max() < 1e-9


@pytest.mark.parametrize("direction", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
def test_a_view_has_a_right_handed_frame(direction):
    view = View(np.array(direction), np.zeros(3), 8, 1.0)
    frame = np.stack([view.right, view.up, view.direction])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_allclose(view.project(np.zeros((1, 3)))[0], [[4.0, 4.0]])


def test_a_texel_takes_the_colour_of_its_own_surface():
    texels = texels_of(square(), SIZE)
    sighting = sight(texels, above(), picture(np.zeros((16, 16))), Belonging(np.array([0, 1]), np.array([0]), 9), 0.5)
    assert sighting.known.all()
    np.testing.assert_allclose(sighting.coverage, 1.0)
    np.testing.assert_allclose(sighting.radiance, np.broadcast_to([0.2, 0.4, 0.6], sighting.radiance.shape), rtol=1e-6)


def test_nothing_seen_is_known_to_be_empty():
    texels = texels_of(square(), SIZE)
    sighting = sight(texels, above(), picture(np.full((16, 16), -1)), Belonging(np.array([0, 1]), np.array([0]), 9), 0.5)
    assert sighting.known.all() and len(sighting.visible) == 0
    assert (sighting.coverage == 0.0).all()


@pytest.mark.parametrize(("height", "known"), [(5.0, False), (-5.0, True)], ids=["before", "behind"])
def test_another_surface_hides_only_what_is_behind_it(height, known):
    texels = texels_of(square(), SIZE)
    other = picture(np.full((16, 16), 7), height)
    sighting = sight(texels, above(), other, Belonging(np.array([0, 1]), np.array([0]), 9), 0.5)
    assert (sighting.known == known).all()
    assert len(sighting.visible) == 0
    assert (sighting.coverage == 0.0).all()


def test_the_border_between_two_surfaces_keeps_their_colours_apart():
    faces = np.zeros((16, 16))
    faces[:, 8:] = 7
    mixed = picture(faces, 5.0)
    mixed.radiance[0, :, 8:] = 99.0
    texels = texels_of(square(), SIZE)
    sighting = sight(texels, above(), mixed, Belonging(np.array([0, 1]), np.array([0]), 9), 0.5)
    assert sighting.radiance.max() < 1.0
    left = texels.pixels[:, 0] < 8
    assert sighting.known[left].all() and not sighting.known[~left].any()


def test_a_texel_that_its_surface_half_covers_is_half_opaque():
    """The edge lies a third into the texels at x = 8: one part in three is covered, and its colour is that of the surface alone."""
    whole = picture(np.zeros((16, 16)))
    whole.faces[:, 25:] = -1
    texels = texels_of(square(), SIZE)
    sighting = sight(texels, above(), whole, Belonging(np.array([0, 1]), np.array([0]), 9), 0.5)
    edge = texels.pixels[:, 0] == 8
    np.testing.assert_allclose(sighting.coverage[edge], 1.0 / 3.0, rtol=1e-6)
    np.testing.assert_array_equal(sighting.parts, np.where(edge, 3, 9)[sighting.visible])
    np.testing.assert_allclose(sighting.radiance[0], np.broadcast_to([0.2, 0.4, 0.6], sighting.radiance[0].shape), rtol=1e-6)


def test_antialiased_colours_are_made_straight():
    whole = picture(np.zeros((16, 16)))
    half = Picture(0.5 * whole.radiance, 0.5 * whole.coverage, whole.faces, whole.heights)
    sighting = sight(texels_of(square(), SIZE), above(), half, Belonging(np.array([0, 1]), np.array([0]), 9), 0.5)
    np.testing.assert_allclose(sighting.radiance[0], np.broadcast_to([0.2, 0.4, 0.6], sighting.radiance[0].shape), rtol=1e-6)


def test_a_view_from_the_side_reads_the_side():
    view = View(np.array([1.0, 0.0, 0.0]), np.array([8.0, 8.0, 0.0]), 16, 1.0)
    rows, columns = view.cells(np.array([[0.0, 9.5, 2.5], [5.0, 100.0, 0.0]]))
    np.testing.assert_array_equal(rows, [10, 8])
    np.testing.assert_array_equal(columns, [9, 15])


@pytest.mark.parametrize("largest", [0, 10**8], ids=["sorted", "table"])
def test_quads_show_their_own_faces_alone(largest, monkeypatch):
    """Also where a picture holds faces that no quad shows, beyond the last one that any does."""
    monkeypatch.setattr(texels_module, "LARGEST_TABLE", largest)
    drawn = [[0, 3], [1], [], [2, 3, 4]]
    belongs = Belonging(np.cumsum([0, *map(len, drawn)]), np.concatenate(drawn).astype(np.int64), 5)
    quads, faces = (each.ravel() for each in np.meshgrid(np.arange(4), np.arange(-1, 12), indexing="ij"))
    np.testing.assert_array_equal(belongs(quads, faces), [face in drawn[quad] for quad, face in zip(quads, faces, strict=True)])
