"""Pictures of stages: parts of photographs that are not used are red, and texels belong to one of three classes."""

import numpy as np

from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.previews import INTERPOLATED, MAX_STAGE_SIDE, PHOTOGRAPHED, UNBOUND, UNCOVERED, classify_texels, draw_trust
from photo_scenes import camera_at


def gray(width, height, mask=None):
    return Photograph(camera_at((0.0, 0.0, 3.0)), np.full((height, width, 3), 128, np.uint8), mask)


def test_untrusted_cells_and_masked_pixels_are_red():
    cells = np.ones((6, 8), np.float32)
    cells[:, :4] = 0.0
    mask = np.ones((60, 80), bool)
    mask[-10:] = False
    image = draw_trust(gray(80, 60, mask), cells)
    is_red = image[..., 0] > image[..., 1] + 0.1
    assert is_red[:, :35].all() and is_red[-10:].all()
    assert not is_red[:48, 45:].any() and np.allclose(image[:48, 45:], 128 / 255)


def test_large_photographs_become_small_pictures():
    assert max(draw_trust(gray(3 * MAX_STAGE_SIDE + 5, 30), np.ones((2, 100), np.float32)).shape) <= MAX_STAGE_SIDE


def test_classes():
    corners, bound = np.array([[0, 1, 2], [1, 2, 3]]), np.array([True, True, True, False])
    triangles, found = np.array([-1, 0, 0, 1, 1]), np.array([False, True, False, True, False])
    assert classify_texels(triangles, found, corners, bound).tolist() == [UNCOVERED, PHOTOGRAPHED, INTERPOLATED, PHOTOGRAPHED, UNBOUND]
