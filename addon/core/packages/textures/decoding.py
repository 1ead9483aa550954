"""Textures of packages as pixels again, in any state."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from ...jobs.chunks import map_ordered
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
        tiles = np.full((*pyramid.shapes[0], side, side, 3), MISSING, np.uint8)
        show = partial(_show_increment, tiles, texture, pyramid, increments, parts)
        for _ in map_ordered(show, np.flatnonzero((increments.textures == index) & is_shown).tolist()):
            pass
        images.append(join_tiles(tiles.reshape(-1, side, side, 3), TileGrid(texture.width, texture.height, side))[::-1])
    return images


def _show_increment(
    tiles: np.ndarray, texture: PackageTexture, pyramid: TilePyramid, increments: Increments, parts: Sequence[memoryview], number: int
) -> None:
    """Write the pixels of an increment to `tiles` (R, C, S, S, 3) uint8."""
    level, row, column = pyramid.locate(int(increments.tiles[number]))
    coded = decode_tile(texture.headers[int(increments.headers[number])], parts[number], pyramid.side(level))
    enlarged = enlarge(coded, level)
    side = texture.tile_size
    count = len(enlarged) // side
    found = enlarged.reshape(count, side, count, side, 3).swapaxes(1, 2)
    shown = tiles[pyramid.covered(level, row, column)]
    shown[:] = found[: shown.shape[0], : shown.shape[1]]
