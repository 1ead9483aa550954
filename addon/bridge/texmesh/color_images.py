"""The image that gives a material its color, as an array."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np

from ..imaging.color_spaces import read_linear_pixels
from ..imaging.images import check_pixels
from ..shading.color_textures import find_color_textures
from ..shading.surface_reader import read_surface
from ..shading.texture_uses import read_texture_use

MAX_SIDE = 4096  # pixels; larger images are halved until they fit


def find_color_images(material: bpy.types.Material | None) -> list[tuple[bpy.types.Image, str]]:
    """Return the images of all image textures that the color of the surface of a material depends on, each once, the nearest one first,
    with the names of the UV maps that they use ("" for the active one).

    Links are followed from the active output, through groups and reroutes. Images for roughness, normals and other inputs do not count.
    """
    found: dict[bpy.types.Image, str] = {}
    for source in () if material is None else find_color_textures(material):
        found.setdefault(source.node.image, read_texture_use(source).uv_map)
    return list(found.items())


def read_plain_color(material: bpy.types.Material | None) -> np.ndarray | None:
    """Return the constant color of a material as an image of one pixel (1, 1, 3) float32, scene-linear, None if it has another color."""
    if material is None:
        return None
    color = read_surface(material).color
    return np.array(color.factor, np.float32).reshape(1, 1, 3) if color.is_constant else None


def read_color_image(image: bpy.types.Image) -> tuple[np.ndarray, bool]:
    """Return the colors (H, W, 3) float32 of an image, scene-linear, row 0 at the bottom, and whether it was scaled down to MAX_SIDE.

    Raises:
        FileError: it has no pixels, for instance because its file is missing.
    """
    check_pixels(image)
    with scaled_copy(image, MAX_SIDE) as source:
        return _read_colors(source), source != image


@contextmanager
def scaled_copy(image: bpy.types.Image, max_side: int) -> Iterator[bpy.types.Image]:
    """Yield an image of at most `max_side` pixels per side: `image` itself, or a copy that is removed afterwards."""
    side = max(image.size)
    if side <= max_side:
        yield image
        return
    copy = image.copy()
    try:
        copy.scale(*(max(1, round(length * max_side / side)) for length in image.size))
        yield copy
    finally:
        bpy.data.images.remove(copy)


def _read_colors(image: bpy.types.Image) -> np.ndarray:
    return np.ascontiguousarray(read_linear_pixels(image)[..., :3])
