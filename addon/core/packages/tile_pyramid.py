"""Tiles of a texture at halved resolutions: how they are numbered, and what each covers."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

MIN_SIDE = 32  # pixels of a tile that shows a whole texture


@dataclass(frozen=True)
class TilePyramid:
    """Square tiles of `tile_size` pixels of a texture of `width` x `height` pixels, and of the texture at halved resolutions.

    Level 0 has the texture itself, level k one that is halved k times. So a tile of level k shows 2^k x 2^k tiles of level 0, until one
    tile shows them all; from there on the tile itself is halved, as long as its side is even and at least MIN_SIDE afterwards. Tiles are
    numbered level by level from level 0 on, row by row from the top left corner.
    """

    width: int
    height: int
    tile_size: int

    @cached_property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """Rows and columns of tiles of each level."""
        shapes = [(-(-self.height // self.tile_size), -(-self.width // self.tile_size))]
        while max(shapes[-1]) > 1:
            rows, columns = shapes[-1]
            shapes.append(((rows + 1) // 2, (columns + 1) // 2))
        side = self.tile_size
        while side % 2 == 0 and side // 2 >= MIN_SIDE:
            side //= 2
            shapes.append((1, 1))
        return tuple(shapes)

    def side(self, level: int) -> int:
        """Return the side in pixels of the tiles of a level."""
        return self.tile_size >> (level - self.shapes.index((1, 1)) if self.shapes[level] == (1, 1) else 0)

    @cached_property
    def starts(self) -> np.ndarray:
        """The number of the first tile of each level, and of all tiles, (L + 1,) int64."""
        return np.concatenate([[0], np.cumsum([rows * columns for rows, columns in self.shapes])]).astype(np.int64)

    @property
    def tile_count(self) -> int:
        return int(self.starts[-1])

    def locate(self, number: int) -> tuple[int, int, int]:
        """Return the level of a tile, and its row and column there."""
        level = int(np.searchsorted(self.starts, number, side="right")) - 1
        row, column = divmod(number - int(self.starts[level]), self.shapes[level][1])
        return level, row, column

    def covered(self, level: int, row: int, column: int) -> tuple[slice, slice]:
        """Return the rows and columns of tiles of level 0 that a tile shows."""
        rows, columns = self.shapes[0]
        top, left = row << level, column << level
        return slice(top, min(top + (1 << level), rows)), slice(left, min(left + (1 << level), columns))


def sum_tiles(values: np.ndarray, level: int) -> np.ndarray:
    """Return the sums (..., R', C') over the tiles of `level` of `values` (..., R, C) of tiles of level 0."""
    for _ in range(level):
        rows, columns = values.shape[-2:]
        padding = [(0, 0)] * (values.ndim - 2) + [(0, rows % 2), (0, columns % 2)]
        padded = np.pad(values, padding)
        values = padded[..., ::2, ::2] + padded[..., 1::2, ::2] + padded[..., ::2, 1::2] + padded[..., 1::2, 1::2]
    return values
