"""Textures of packages as pixels again, in any state."""

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
    textures: Sequence[PackageTexture], increments: Increments, content: bytes | memoryview, state: int | None = None
) -> list[np.ndarray]:
    """Return the textures (H, W, 3) uint8, row 0 at the bottom, that a state has, the last one by default.

    content: the bytes of the increments, one after the other.

    Raises:
        FileError: a tile is damaged.
    """
    parts = increments.split(content)
    is_shown = increments.are_in(increments.state_count - 1 if state is None else state)
    images = []
    for index, texture in enumerate(textures):
        side, pyramid = texture.tile_size, TilePyramid(texture.width, texture.height, texture.tile_size)
        rows, columns = pyramid.shapes[0]
        tiles = np.full((rows, columns, side, side, 3), MISSING, np.uint8)
        for number in np.flatnonzero((increments.textures == index) & is_shown).tolist():
            level, row, column = pyramid.locate(int(increments.tiles[number]))
            covered = pyramid.covered(level, row, column)
            coded = decode_tile(texture.headers[int(increments.headers[number])], parts[number], pyramid.side(level))
            enlarged = enlarge(coded, level)
            count = len(enlarged) // side
            found = enlarged.reshape(count, side, count, side, 3).swapaxes(1, 2)
            shown = tiles[covered]
            shown[:] = found[: shown.shape[0], : shown.shape[1]]
        images.append(join_tiles(tiles.reshape(-1, side, side, 3), TileGrid(texture.width, texture.height, side))[::-1])
    return images
