"""Texture tiles as image files, which are kept in memory."""

from collections import OrderedDict

from ..textures.grid import TILE_SIZE
from ..textures.image_files import TARGA_HEADER, to_image_files
from ..textures.store import TextureStore
from ..textures.tile_blocks import CodedTile

MAX_TEXTURE_BYTES = 32 << 20


class TextureFiles:
    """Reads texture tiles and keeps those used last, up to a number of bytes. One thread at a time may use it."""

    def __init__(self, textures: TextureStore, max_bytes: int = MAX_TEXTURE_BYTES) -> None:
        self.max_bytes, self.byte_count = max_bytes, 0
        self._textures = textures
        self._tiles: OrderedDict[int, CodedTile] = OrderedDict()

    def get(self, number: int) -> CodedTile:
        """Return the image files of a texture tile.

        Raises:
            FileError, ImageError: it is damaged.
        """
        if number in self._tiles:
            self._tiles.move_to_end(number)
            return self._tiles[number]
        tile = self._tiles[number] = to_image_files(self._textures.read_coded(number))
        self.byte_count += _count_bytes(tile)
        while self.byte_count > self.max_bytes and len(self._tiles) > 1:
            self.byte_count -= _count_bytes(self._tiles.popitem(last=False)[1])
        return tile

    def touch(self, number: int) -> int | None:
        """Keep a tile as if it had just been used. Returns its bytes, None if it is not there."""
        if number not in self._tiles:
            return None
        self._tiles.move_to_end(number)
        return _count_bytes(self._tiles[number])

    def bound_bytes(self, number: int) -> int:
        """Return at least the bytes of a tile that has not been read."""
        return int(self._textures.sizes[number]) + TARGA_HEADER.size + 4 * TILE_SIZE**2


def _count_bytes(tile: CodedTile) -> int:
    return len(tile.color) + len(tile.alpha or b"")
