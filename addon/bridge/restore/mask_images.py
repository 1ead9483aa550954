"""New mask images: black, to be painted white where pixels are missing."""

import bpy

from ...compat import image_paint_settings
from .image_users import MASKED_PROPERTY

SUFFIX = " mask"
BLACK, WHITE = (0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0)


def create_mask(source: bpy.types.Image) -> bpy.types.Image:
    """Create a packed black image with the size and the tiles of `source`, for which it is the mask from then on."""
    is_tiled = source.source == "TILED"
    width, height = source.size
    mask = bpy.data.images.new(source.name + SUFFIX, width, height, alpha=False, is_data=True, tiled=is_tiled)
    if is_tiled:
        mask.tiles[0].number = min(tile.number for tile in source.tiles)
        for tile in source.tiles:
            _fill_tile(mask, tile)
    mask.pack()
    mask[MASKED_PROPERTY] = source
    return mask


def set_brush_color(tools: bpy.types.ToolSettings, color: tuple[float, float, float]) -> None:
    """Give the brushes that paint images this color: the one that they share, and that of the active brush."""
    image_paint_settings(tools).color = color
    brush = tools.image_paint.brush
    if brush is not None and brush.is_editable:
        brush.color = color


def _fill_tile(mask: bpy.types.Image, tile: bpy.types.UDIMTile) -> None:
    """Add a black tile to `mask`, or make an existing one black, with the number and the size of `tile`."""
    mask.tiles.active = mask.tiles.get(tile.number) or mask.tiles.new(tile.number)
    with bpy.context.temp_override(edit_image=mask):
        bpy.ops.image.tile_fill(color=BLACK, width=tile.size[0], height=tile.size[1], float=False, alpha=False)
