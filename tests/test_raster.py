"""Triangles in pixels: every pixel of a picture once, the nearest in front, colours where they belong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.raster import covered_pixels, nearest, painted

SIZE = (8, 6)
WHOLE = np.array([[[0, 0], [8, 0], [8, 6]], [[0, 0], [8, 6], [0, 6]]], float)


def test_two_halves_cover_a_picture():
    counts = np.zeros(48, int)
    for _, pixels, shares in covered_pixels(WHOLE, SIZE):
        np.add.at(counts, pixels, 1)
        assert shares.sum(axis=1) == pytest.approx(np.ones(len(shares)))
    assert counts.min() >= 1  # those on the diagonal belong to both
    assert (counts == 1).sum() >= 40


@given(shift=st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)), turned=st.booleans())
def test_coordinates_lead_to_the_middles_of_pixels(shift, turned):
    corners = np.array([[[0.2, 0.1], [7.3, 1.9], [3.1, 5.7]]])[:, :: -1 if turned else 1] + shift
    for owner, pixels, shares in covered_pixels(corners, SIZE):
        found = np.einsum("ni,nij->nj", shares, corners[owner])
        assert found == pytest.approx(np.column_stack([pixels % 8 + 0.5, pixels // 8 + 0.5]), abs=1e-9)


def test_what_is_nearer_hides_what_is_behind():
    corners = np.concatenate([WHOLE, WHOLE[:1]])
    depths = np.array([[2.0, 2, 2], [2, 2, 2], [1, 1, 3]])
    buffer = nearest(corners, depths, SIZE)
    assert buffer.max() == pytest.approx(2.0)
    assert buffer[0, 6] < 2.0 and buffer[5, 0] == pytest.approx(2.0)


def test_empty_pixels_are_infinitely_far():
    assert np.isinf(nearest(np.zeros((0, 3, 2)), np.zeros((0, 3)), SIZE)).all()
    assert np.isinf(nearest(WHOLE[:1] * 0.0, np.zeros((1, 3)), SIZE)).all()


def test_triangles_are_painted_in_their_colours():
    picture = painted(WHOLE, np.array([[1.0, 0, 0], [0, 1, 0]]), SIZE, 0.5)
    assert picture.shape == (6, 8, 3)
    assert picture[0, 7].tolist() == [1, 0, 0] and picture[5, 0].tolist() == [0, 1, 0]
    assert (painted(WHOLE[:0], np.zeros((0, 3)), SIZE, 0.5) == 0.5).all()
