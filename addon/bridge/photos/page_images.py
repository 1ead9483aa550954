"""The pages of a texture as images: one per group, with UDIM tiles where it uses others than the first."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np

from ...core.photos.pages import FIRST_TILE, PageLayout
from ...core.photos.photo_texture import PhotoTexture
from ..imaging.images import create_image
from ..imaging.tiled_images import EXTENSIONS, open_tiles, pack_tiles, save_pixels
from .results import map_pixels, texture_pixels

MAPS = ("Confidence", "Source", "Holes")


def create_textures(
    layout: PageLayout, texture: PhotoTexture, names: Sequence[str], *, has_alpha: bool = False
) -> dict[int, bpy.types.Image]:
    """Create a packed 8-bit image for each group of pages; `names` by group. With `has_alpha`, holes are transparent."""
    images = {}
    for group in dict.fromkeys(layout.groups):
        tiles = layout.find_tiles(group)

        def draw(tile: int, tiles: Mapping[int, int] = tiles) -> np.ndarray:
            page = texture.page(tiles[tile])
            return texture_pixels(page.colors, page.holes if has_alpha else None)

        images[group] = _create_tiles(names[group], list(tiles), draw, is_data=False)
    return images


def create_maps(layout: PageLayout, texture: PhotoTexture, names: Sequence[str], photograph_count: int) -> None:
    """Create the images of confidence, source and holes of each group, which files keep although nothing uses them."""
    for group in dict.fromkeys(layout.groups):
        tiles = layout.find_tiles(group)
        for name in MAPS:

            def draw(tile: int, name: str = name, tiles: Mapping[int, int] = tiles) -> np.ndarray:
                page = texture.page(tiles[tile])
                values = {"Confidence": page.confidence, "Source": (page.source + 1.0) / photograph_count, "Holes": page.holes}
                return map_pixels(values[name])

            _create_tiles(f"{names[group]} {name}", list(tiles), draw, is_data=True).use_fake_user = True


def _create_tiles(name: str, tiles: list[int], draw: Callable[[int], np.ndarray], *, is_data: bool) -> bpy.types.Image:
    """Create a packed image of pixels (H, W, 4) that `draw` returns for each tile; a tiled one unless tile 1001 is the only one."""
    if tiles == [FIRST_TILE]:
        return create_image(name, draw(FIRST_TILE), is_data=is_data)
    with tempfile.TemporaryDirectory() as folder:
        paths = {tile: Path(folder, f"tile.{tile}.{EXTENSIONS[False]}") for tile in tiles}
        for tile, path in paths.items():
            save_pixels(draw(tile), path, is_float=False)
        image = open_tiles(name, paths, "Non-Color" if is_data else "sRGB", "CHANNEL_PACKED")
        pack_tiles(image, EXTENSIONS[False])
    return image
