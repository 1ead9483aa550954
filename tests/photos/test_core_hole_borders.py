"""Interpolated holes: they meet what is around them without a jump, however coarse the mesh is."""

import numpy as np
import pytest

from farfield.addon.core.photos.texels.hole_interpolation import continue_differences, interpolate_holes
from farfield.addon.core.photos.texels.texel_map import TexelMap
from photo_scenes import grid

SIZE = 64


def gradient():
    """Colors (N, 3) that rise with column and row."""
    rows, columns = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    return np.stack([columns, rows, 0.5 * (columns + rows)], axis=-1).reshape(-1, 3).astype(np.float32)


def disc(radius=14):
    rows, columns = np.mgrid[:SIZE, :SIZE]
    return (np.hypot(rows - 31.5, columns - 29.5) < radius).ravel()


def fill(corner_colors, colors=None, hole=None):
    _, uvs = grid(2)
    hole = disc() if hole is None else hole
    result = (gradient() if colors is None else colors).copy()
    result[hole] = -1.0
    interpolate_holes(TexelMap(uvs, SIZE), result, ~hole, corner_colors.astype(np.float32))
    return result, hole


@pytest.mark.parametrize("offset", [0.0, 0.2])
def test_a_gradient_on_a_coarse_plane_is_continued_through_the_hole(offset):
    """Also if the colors of all vertices are wrong by an offset."""
    _, uvs = grid(2)
    colors, hole = fill(np.concatenate([uvs, uvs.mean(axis=2, keepdims=True)], axis=2) + offset)
    assert np.abs(colors - gradient())[hole].max() < 0.02
    assert np.array_equal(colors[~hole], gradient()[~hole])


def test_there_is_no_jump_at_the_border_of_a_hole_in_a_triangle_with_wrong_vertices():
    random = np.random.default_rng(3)
    vertex_colors = random.uniform(0.0, 1.0, (9, 3))
    mesh, _ = grid(2)
    colors, hole = fill(vertex_colors[mesh.triangles])
    image, is_hole = colors.reshape(SIZE, SIZE, 3), hole.reshape(SIZE, SIZE)
    jumps = np.abs(np.diff(image, axis=1))[is_hole[:, 1:] != is_hole[:, :-1]]
    assert jumps.mean() < 0.06, "steps of the gradient are 0.016, and those of the wrong vertices 0.03"


def test_a_hole_without_a_border_stays_as_it_was_interpolated():
    colors, _ = fill(np.full((8, 3, 3), 0.25), hole=np.ones(SIZE * SIZE, bool))
    assert np.array_equal(colors, np.full_like(colors, 0.25))


def test_differences_do_not_cross_rows_or_exceed_those_of_the_border():
    holes, borders = np.array([SIZE - 1, SIZE + 5]), np.array([SIZE, SIZE + 4])
    differences = continue_differences(holes, borders, np.array([[0.5], [-0.3]], np.float32), SIZE)
    assert differences[0, 0] == pytest.approx(0.0, abs=1e-6), "the next row begins there"
    assert differences[1, 0] == pytest.approx(-0.3, abs=1e-3)
