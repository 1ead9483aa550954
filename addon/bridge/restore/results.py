"""New images with restored pixels: packed single images and UDIM tiles, and image sequences that read files."""

import tempfile
from pathlib import Path

import bpy
import numpy as np

from ..imaging.images import EXTENSIONS, load_image, lossless_alpha_mode, open_tiles, pack_tiles, save_pixels
from .image_sources import default_color_space

SUFFIX = " restored"
COPIED_PROPERTIES = ("use_half_precision", "use_view_as_render", "use_deinterlace", "seam_margin")


def create_result(source: bpy.types.Image, tiles: dict[int, np.ndarray]) -> bpy.types.Image:
    """Create a packed image with the stored values (H, W, 4) of its `tiles` and the properties of `source`.

    tiles: by number as from `read_tiles`; the number 0 makes an image without tiles.
    """
    if 0 not in tiles:
        return _create_tiled_image(source, tiles)
    image = _create_image(source, tiles[0])
    image.pack()
    return image


def load_sequence(source: bpy.types.Image, path: Path) -> bpy.types.Image:
    """Return a new image sequence of the files numbered like `path`, which `save_pixels` has written, with the properties of `source`."""
    image = load_image(path)
    image.name = source.name + SUFFIX
    if path.suffix == f".{EXTENSIONS[False]}" or source.colorspace_settings.is_data:  # EXR files are scene-linear, as Blender assumes
        image.colorspace_settings.name = source.colorspace_settings.name
    image.alpha_mode = lossless_alpha_mode(source.alpha_mode, path.suffix == f".{EXTENSIONS[True]}")
    image.source = "SEQUENCE"
    _copy_display_properties(source, image)
    return image


def _create_image(source: bpy.types.Image, pixels: np.ndarray) -> bpy.types.Image:
    height, width = pixels.shape[:2]
    has_alpha = source.depth in {32, 64, 128} or bool((pixels[..., 3] < 1.0).any())
    is_data = source.colorspace_settings.is_data
    image = bpy.data.images.new(source.name + SUFFIX, width, height, alpha=has_alpha, float_buffer=source.is_float, is_data=is_data)
    # Before the pixels: setting these afterwards would erase them.
    image.colorspace_settings.name = default_color_space(source)
    image.alpha_mode = lossless_alpha_mode(source.alpha_mode, source.is_float)
    _copy_display_properties(source, image)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    return image


def _create_tiled_image(source: bpy.types.Image, tiles: dict[int, np.ndarray]) -> bpy.types.Image:
    with tempfile.TemporaryDirectory() as folder:
        paths = {number: Path(folder, f"tile.{number}.{EXTENSIONS[source.is_float]}") for number in sorted(tiles)}
        for number, path in paths.items():
            save_pixels(tiles[number], path, is_float=source.is_float)
        alpha_mode = lossless_alpha_mode(source.alpha_mode, source.is_float)
        image = open_tiles(source.name + SUFFIX, paths, default_color_space(source), alpha_mode)
        for tile in source.tiles:
            image.tiles.get(tile.number).label = tile.label
        _copy_display_properties(source, image)
        pack_tiles(image, EXTENSIONS[source.is_float])
    return image


def _copy_display_properties(source: bpy.types.Image, image: bpy.types.Image) -> None:
    for name in COPIED_PROPERTIES:
        setattr(image, name, getattr(source, name))
    image.display_aspect = source.display_aspect
