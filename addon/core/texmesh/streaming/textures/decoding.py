"""Textures of packages as pixels again, from any number of tiles."""

from collections.abc import Sequence

import numpy as np

from ..increments import Increments
from ..manifest import PackageTexture
from ..tile_pyramid import TilePyramid
from .avif_files import decode_tile
from .coding import MISSING
from .enlarging import enlarge
from .texture_tiles import TileGrid, join_tiles


def decode_textures(
    textures: Sequence[PackageTexture], increments: Increments, content: bytes | memoryview, count: int | None = None
) -> list[np.ndarray]:
    """Return the textures (H, W, 3) uint8, row 0 at the bottom, that the first `count` increments give, all of them by default.

    content: the bytes of the increments, one after the other.

    Raises:
        FileError: a tile is damaged.
    """
    parts = increments.split(content)[:count]
    images = []
    for index, texture in enumerate(textures):
        side, pyramid = texture.tile_size, TilePyramid(texture.width, texture.height, texture.tile_size)
        rows, columns = pyramid.shapes[0]
        tiles = np.full((rows, columns, side, side, 3), MISSING, np.uint8)
        is_known = np.zeros((rows, columns), bool)
        for number in reversed(np.flatnonzero(increments.textures[: len(parts)] == index).tolist()):  # later tiles replace earlier ones
            level, row, column = pyramid.locate(int(increments.tiles[number]))
            covered = pyramid.covered(level, row, column)
            if is_known[covered].all():
                continue
            coded = decode_tile(texture.headers[int(increments.headers[number])], parts[number], pyramid.side(level))
            enlarged = enlarge(coded, level)
            count = len(enlarged) // side
            found = enlarged.reshape(count, side, count, side, 3).swapaxes(1, 2)
            is_new = ~is_known[covered]
            tiles[covered][is_new] = found[: is_new.shape[0], : is_new.shape[1]][is_new]
            is_known[covered] = True
        images.append(join_tiles(tiles.reshape(-1, side, side, 3), TileGrid(texture.width, texture.height, side))[::-1])
    return images
