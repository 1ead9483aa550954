"""Overlays show where the camera sees the mesh."""

import numpy as np

from farfield.addon.core.geometry.lenses import Lens, PhotoCamera
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.previews import DIMMED, LINE_COLOR, MAX_OVERLAY_SIDE, draw_overlay

SQUARE = TriangleMesh(
    np.array([[-1.0, -1.0, 4.0], [1.0, -1.0, 4.0], [1.0, 1.0, 4.0], [-1.0, 1.0, 4.0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
)


def photograph(size=(80, 60), focal=80.0, shift=(0.0, 0.0, 0.0), value=128):
    lens = Lens("SIMPLE_PINHOLE", size, (focal, focal), (0.5 * size[0], 0.5 * size[1]))
    return Photograph(PhotoCamera("a.png", lens, np.eye(3), np.array(shift)), np.full((size[1], size[0], 3), value, np.uint8))


def test_the_mesh_is_shaded_outlined_and_everything_else_dimmed():
    image = draw_overlay(SQUARE, photograph())
    assert image.shape == (60, 80, 3)
    gray = np.float32(128 / 255)
    assert np.allclose(image[:9], DIMMED * gray)
    assert np.allclose(image[:, :19], DIMMED * gray)
    assert np.allclose(image[10, 20:60], LINE_COLOR)
    inside = image[12:48, 22:58]
    assert (inside > gray).all(), "the mesh faces the camera: it is brighter than the photograph, and the diagonal is no crease"


def test_creases_and_steps_of_depth_are_lines():
    near = TriangleMesh(SQUARE.vertices * [0.5, 0.5, 1.0] - [0.0, 0.0, 1.0], SQUARE.triangles)
    both = TriangleMesh(np.concatenate([SQUARE.vertices, near.vertices]), np.concatenate([SQUARE.triangles, near.triangles + 4]))
    image = draw_overlay(both, photograph())
    left = int(40 - 0.5 / 3.0 * 80)
    assert (np.abs(image[30, left - 2 : left + 3] - LINE_COLOR) < 1e-6).all(axis=1).any()
    roof = TriangleMesh(np.array([[-1, 0, 4], [1, 0, 4], [0, 1, 5.0], [0, -1, 5.0]]), np.array([[0, 1, 2], [0, 3, 1]], np.int32))
    image = draw_overlay(roof, photograph())
    assert (np.abs(image[28:32, 40] - LINE_COLOR) < 1e-6).all(axis=1).any()


def test_a_camera_that_sees_nothing_gives_a_dark_photograph():
    image = draw_overlay(SQUARE, photograph(shift=(0.0, 0.0, -9.0)))
    assert np.allclose(image, DIMMED * 128 / 255)


def test_large_photographs_are_drawn_smaller():
    image = draw_overlay(SQUARE, photograph(size=(2 * MAX_OVERLAY_SIDE + 10, 30), focal=3000.0))
    assert max(image.shape) <= MAX_OVERLAY_SIDE
    assert image.shape[0] == 10
