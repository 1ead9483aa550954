"""The textures of a package as they look when only the first increments have come."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..increments import Increments
from ..manifest import PackageTexture
from .progressive_files import decode_tile
from .texture_tiles import TileGrid, join_tiles

MISSING = 128  # value of texels of which nothing has come


def decode_textures(
    textures: Sequence[PackageTexture], increments: Increments, content: bytes | memoryview, count: int, threads: int = 2
) -> list[np.ndarray]:
    """Return the textures (H, W, 3) uint8, row 0 at the bottom, of the first `count` increments.

    Args:
        content: the bytes of all increments, one after the other.

    Raises:
        FileError: an increment is damaged.
    """
    view, ends = memoryview(content), np.cumsum(increments.sizes)
    owners, tiles = increments.textures[:count], increments.tiles[:count]
    images = []
    for index, texture in enumerate(textures):
        rows = np.flatnonzero(owners == index)
        rows = rows[np.argsort(tiles[rows], kind="stable")]
        numbers, starts = np.unique(tiles[rows], return_index=True)
        groups = np.split(rows, starts[1:]) if len(rows) else []

        def decode(group: np.ndarray, headers: tuple[bytes, ...] = texture.headers) -> np.ndarray:
            parts = [view[ends[row] - increments.sizes[row] : ends[row]] for row in group]
            return decode_tile(headers[increments.headers[group[0]]], parts)[::-1]

        grid = TileGrid(texture.width, texture.height, texture.tile_size)
        pixels = np.full((texture.tile_count, texture.tile_size, texture.tile_size, 3), MISSING, np.uint8)
        with ThreadPoolExecutor(threads) as pool:
            for number, tile in zip(numbers.tolist(), pool.map(decode, groups), strict=True):
                pixels[number] = tile
        images.append(join_tiles(pixels, grid)[::-1])
    return images
