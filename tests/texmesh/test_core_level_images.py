"""Images of levels with other textures: the same as those of a level that is opened with them."""

import numpy as np
import pytest

from farfield.addon.core.geometry.directions import fibonacci_sphere
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.imaging.mipmaps import build_mipmaps
from farfield.addon.core.packages.material_sources import build_color_mipmaps
from farfield.addon.core.texmesh.perception.level_images import LevelImages, measure_difference, prepare_images
from farfield.addon.core.texmesh.perception.views import frame_around, prepare_surface
from textured_models import torus

VIEWS, SIZE = 2, 48


def paint(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (40, 24, 3)).astype(np.uint8)


def open_level(textures: list, placed: dict | None = None) -> LevelImages:
    mesh = torus(24, 12, has_materials=True)
    return LevelImages(prepare_surface(mesh, textures), frame_around(mesh.vertices), fibonacci_sphere(VIEWS), 67.0, placed)


def to_textures(*seeds: int) -> list:
    return [build_mipmaps(LINEAR_OF_BYTE[paint(seed)]) for seed in seeds]


def test_replaced_textures_give_the_images_of_a_level_with_them():
    level, other = open_level(to_textures(1, 2), {}), open_level(to_textures(3, 4))
    prepare_images([level], range(VIEWS), SIZE)
    assert measure_difference(level, other, SIZE, range(VIEWS)).means.min() > 0.01
    level.forget_textures()
    replaced = level.replace_textures(to_textures(3, 4))
    assert not measure_difference(replaced, other, SIZE, range(VIEWS)).highs.any()
    assert level.placed is replaced.placed and len(level.placed) == VIEWS


def test_images_stay_without_textures():
    level, same = open_level(to_textures(1, 2)), open_level(to_textures(1, 2))
    prepare_images([level], range(VIEWS), SIZE)
    level.forget_textures()
    assert not measure_difference(level, same, SIZE, range(VIEWS)).highs.any()


@pytest.mark.parametrize("color", [(1.0, 1.0, 1.0, 1.0), (0.5, 0.25, 1.0, 1.0)])
def test_mipmaps_of_bytes_are_those_of_linear_colors(color):
    expected = build_mipmaps(LINEAR_OF_BYTE[paint(5)] * np.float32(color[:3]))
    found = build_color_mipmaps(paint(5), color)
    np.testing.assert_allclose(found.texels, expected.texels, rtol=1e-6)
    assert build_color_mipmaps(None, color) is None
