"""Rasterized triangles cover every pixel once, with correct barycentric coordinates, depth order and colors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.imaging.raster import depth_buffer, fill_triangles, list_drawn, rasterize

SIZE = (8, 6)
FULL = np.array([[[0, 0], [8, 0], [8, 6]], [[0, 0], [8, 6], [0, 6]]], float)


def test_two_triangles_cover_an_image():
    counts = np.zeros(48, int)
    for _, pixels, barycentric in rasterize(FULL, SIZE):
        np.add.at(counts, pixels, 1)
        assert barycentric.sum(axis=1) == pytest.approx(np.ones(len(barycentric)))
    assert counts.min() >= 1  # pixels on the diagonal belong to both
    assert (counts == 1).sum() >= 40


@given(shift=st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)), reverse=st.booleans())
def test_barycentric_coordinates_give_pixel_centers(shift, reverse):
    corners = np.array([[[0.2, 0.1], [7.3, 1.9], [3.1, 5.7]]])[:, :: -1 if reverse else 1] + shift
    for triangle, pixels, barycentric in rasterize(corners, SIZE):
        positions = np.einsum("ni,nij->nj", barycentric, corners[triangle])
        assert positions == pytest.approx(np.column_stack([pixels % 8 + 0.5, pixels // 8 + 0.5]), abs=1e-9)


def test_the_nearest_triangle_wins():
    corners = np.concatenate([FULL, FULL[:1]])
    depths = np.array([[2.0, 2, 2], [2, 2, 2], [1, 1, 3]])
    buffer = depth_buffer(corners, depths, SIZE)
    assert buffer.max() == pytest.approx(2.0)
    assert buffer[0, 6] < 2.0 and buffer[5, 0] == pytest.approx(2.0)


def test_empty_pixels_have_infinite_depth():
    assert np.isinf(depth_buffer(np.zeros((0, 3, 2)), np.zeros((0, 3)), SIZE)).all()
    assert np.isinf(depth_buffer(FULL[:1] * 0.0, np.zeros((1, 3)), SIZE)).all()


def test_triangles_are_filled_with_their_colors():
    image = fill_triangles(FULL, np.array([[1.0, 0, 0], [0, 1, 0]]), SIZE, 0.5)
    assert image.shape == (6, 8, 3)
    assert image[0, 7].tolist() == [1, 0, 0] and image[5, 0].tolist() == [0, 1, 0]
    assert (fill_triangles(FULL[:0], np.zeros((0, 3)), SIZE, 0.5) == 0.5).all()


def test_drawn_triangles_are_listed_once_and_pixels_have_their_rows():
    owners = np.array([7, 2, 2, 9, 7], np.int32)
    drawn, rows = list_drawn(owners, 12)
    assert drawn.tolist() == [2, 7, 9] and rows.tolist() == [1, 0, 0, 2, 1]
    drawn, rows = list_drawn(owners[:0], 12)
    assert not len(drawn) and not len(rows)
