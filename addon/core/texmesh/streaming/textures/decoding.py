"""Textures of packages as pixels again, from any number of increments."""

from collections.abc import Sequence

import numpy as np

from ..increments import Increments
from ..manifest import PackageTexture
from .progressive_files import decode_tile
from .texture_tiles import TileGrid, join_tiles

MISSING = 128  # of all channels of tiles without increments, as a JPEG file without coefficients


def decode_textures(
    textures: Sequence[PackageTexture], increments: Increments, content: bytes | memoryview, count: int | None = None
) -> list[np.ndarray]:
    """Return the textures (H, W, 3) uint8, row 0 at the bottom, that the first `count` increments give, all of them by default.

    content: the bytes of the increments, one after the other.

    Raises:
        FileError: a tile is damaged.
    """
    parts: dict[tuple[int, int], list[memoryview]] = {}
    headers: dict[tuple[int, int], bytes] = {}
    for index, part in enumerate(increments.split(content)[:count]):
        texture = int(increments.textures[index])
        key = texture, int(increments.tiles[index])
        parts.setdefault(key, []).append(part)
        headers[key] = textures[texture].headers[int(increments.headers[index])]
    images = []
    for number, texture in enumerate(textures):
        side = texture.tile_size
        tiles = np.full((texture.tile_count, side, side, 3), MISSING, np.uint8)
        for key in parts:
            if key[0] == number:
                tiles[key[1]] = decode_tile(headers[key], parts[key])[::-1]
        images.append(join_tiles(tiles, TileGrid(texture.width, texture.height, side))[::-1])
    return images
