"""Ground with caves and overhangs that points are put on."""

import numpy as np
import pytest

from farfield.addon.core.geometry.surfaces import SolidSurface

RISE = 0.5


def layers(*heights):
    """Squares at heights that rise along X: every second one, the first included, faces up, the others down."""
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return [
        (np.column_stack([square, height + RISE * square[:, 0]]), triangles if index % 2 == 0 else triangles[:, ::-1])
        for index, height in enumerate(heights)
    ]


@pytest.mark.parametrize(("z", "ground"), [(40.0, 30.0), (31.0, 30.0), (25.0, 30.0), (15.0, 10.0), (10.5, 10.0), (3.0, 10.0)])
def test_points_fall_on_the_ground_below_and_rise_out_of_rock(z, ground):
    surface = SolidSurface(layers(10.0, 20.0, 30.0))  # Ground, and a bridge from 20 to 30.
    heights, normals = surface.find(np.array([[2.2, 1.7, z + RISE * 2.2], [9.0, 9.0, z]]))
    assert heights[0] == pytest.approx(ground + RISE * 2.2) and np.isnan(heights[1])
    assert np.allclose(normals[0], np.array([-RISE, 0.0, 1.0]) / np.hypot(RISE, 1.0))


def test_below_a_ceiling_without_ground_points_rise_to_the_nearest_floor():
    floating = layers(30.0, 20.0)
    heights, _ = SolidSurface(floating).find(np.array([[1.0, 1.0, 5.0], [1.0, 1.0, np.nan]]))
    assert heights[0] == pytest.approx(30.0 + RISE) and np.isnan(heights[1])


def test_without_triangles_there_is_no_ground():
    heights, normals = SolidSurface([]).find(np.zeros((2, 3)))
    assert np.isnan(heights).all() and np.isnan(normals).all() and normals.shape == (2, 3)
