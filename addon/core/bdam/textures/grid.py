"""Layout of the texture quadtree: which tile holds which texels, and where a texel lies.

Grid coordinates (x, y) are columns and rows of the field's samples. The root tile is the square of side S = `size` cells from (0, 0); tile
(t, i, j) of level t covers S / 2**t cells from (i, j) times that. All texels of level t form one lattice of STEP * 2**t texels per side:
texel k, counted from 0 along one axis, covers texel(t) = S / (STEP * 2**t) cells, and its center is at (k + 0.5) * texel(t).

A tile of TILE_SIZE = 512 texels holds the STEP = 504 texels of its own square and BORDER = 4 texels more on every side: the texels
STEP * i - BORDER to STEP * (i + 1) + BORDER - 1. Bilinear interpolation up to the border of the square, and on to 3.5 texels beyond it,
finds its texels in this tile, with the same values as in the neighbor. From grid coordinates to the tile's UV (0 to 1, v upwards):

    u = (BORDER + STEP * (x * 2**t / S - i)) / TILE_SIZE        v = (BORDER + STEP * (y * 2**t / S - j)) / TILE_SIZE

The overlap of two tiles is 2 * BORDER = 8 texels and begins at a multiple of 8 in both: it consists of whole blocks of JPEG, which are
coded alike in both, so that even coded tiles agree exactly there (see `coded_images.encode`).
"""

from dataclasses import dataclass

import numpy as np

TILE_SIZE, BORDER = 512, 4
STEP = TILE_SIZE - 2 * BORDER
MAX_COARSER = 1.0 / 32.0  # a texel may be this much larger than a pixel: 16,384 pixels fit into 32 tiles, which have 16,128 texels
MAX_LEVELS = 20  # what 64-bit keys of tiles and positions of texels have room for


@dataclass(frozen=True)
class TextureGrid:
    """The squares of the texture quadtree over a field.

    Attributes:
        columns, rows: samples of the field, at least 2 each. The field covers (0, 0) to (columns - 1, rows - 1).
        size: side of the root square in cells, S.
        spacing: meters between neighboring samples along x and y.
        level_count: levels of tiles; the finest one is level_count - 1.
    """

    columns: int
    rows: int
    size: int
    spacing: tuple[float, float]
    level_count: int

    @property
    def extent(self) -> tuple[int, int]:
        """Width and height of the field in cells."""
        return self.columns - 1, self.rows - 1

    def texel(self, level: int) -> float:
        """Return the side of a texel in cells."""
        return self.size / (STEP << level)

    def texel_meters(self, level: int) -> float:
        """Return the longer side of a texel in meters."""
        return self.texel(level) * max(self.spacing)

    def tile_counts(self, level: int) -> tuple[int, int]:
        """Return the number of tiles along x and y that have a part of the field."""
        return tuple(-(-(cells << level) // self.size) for cells in self.extent)

    def texel_counts(self, level: int) -> tuple[int, int]:
        """Return the number of texels along x and y of which at least a part lies in the field."""
        return tuple(-(-cells * (STEP << level) // self.size) for cells in self.extent)

    def inside(self, level: int, axis: int, texels: np.ndarray) -> np.ndarray:
        """Return for texel indices (N,) along an axis (0: x, 1: y) the part of each that lies in the field, (N,) float32, 0 to 1."""
        ends = self.extent[axis] * (STEP << level) / self.size
        return np.clip(np.minimum(ends - texels, texels + 1.0), 0.0, 1.0).astype(np.float32)

    def centers(self, level: int, axis: int, texels: np.ndarray) -> np.ndarray:
        """Return the grid coordinates (N,) float64 of the centers of texels, moved into the field where they lie beyond its border."""
        return np.clip((texels + 0.5) * self.texel(level), 0.0, self.extent[axis])


def count_levels(size: int, depth: int, pixel: float) -> int:
    """Return the number of levels whose finest texels are no larger than a pixel of the images, but at most depth + 1.

    size: side of the root square in cells. depth: the finest level that the geometry has tiles for. pixel: side of the smallest pixel of
    all images in cells. A texel may be larger by MAX_COARSER.
    """
    level = 0
    while level < min(depth, MAX_LEVELS - 1) and size / (STEP << level) > pixel * (1.0 + MAX_COARSER):
        level += 1
    return level + 1
