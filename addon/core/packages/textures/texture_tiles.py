"""Textures of a mesh as tiles: texels that no triangle uses are filled so that they cost few bytes.

Arrays of tiles have row 0 at the top, as the files and the format of packages.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from ...errors import ImageError
from ...imaging.images import dilate_in_place
from ...imaging.raster import rasterize
from ...texmesh.textured_mesh import TexturedMesh
from ..manifest import MAX_TEXTURE_SIDE, MAX_TILES, ROLES

MARGIN = 4  # texels around triangles that are used too: bilinear samples and mipmaps read them
MAX_PERIODS = 16  # Periods of a texture that repeats; with more, all of it is used.


@dataclass(frozen=True, eq=False)
class TextureSource:
    """A texture to code, and what uses it.

    Attributes:
        role: one of ROLES.
        image: (H, W, 3) uint8 as stored (sRGB-encoded colors, or data such as normals), row 0 at the bottom.
        mesh: the finest level.
        materials: those of its materials, by number, that use the texture.
        name: for messages.
    """

    role: str
    image: np.ndarray
    mesh: TexturedMesh
    materials: tuple[int, ...]
    name: str = "texture"


@dataclass(frozen=True)
class TileGrid:
    """How a texture of `width` x `height` pixels is divided into tiles: `rows` x `columns` squares of `tile_size`."""

    width: int
    height: int
    tile_size: int

    @property
    def columns(self) -> int:
        return -(-self.width // self.tile_size)

    @property
    def rows(self) -> int:
        return -(-self.height // self.tile_size)

    @property
    def padded_shape(self) -> tuple[int, int]:
        """Rows and columns of pixels of all tiles together."""
        return self.rows * self.tile_size, self.columns * self.tile_size


def check_source(source: TextureSource, tile_size: int) -> TileGrid:
    """Return the tiles of a source.

    Raises:
        ImageError: the image has another shape or type, or too many pixels; the role is unknown; no triangle uses it.
    """
    image = source.image
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise ImageError(f'"{source.name}" must have pixels with three channels of 8 bits to be sent; convert it.')
    grid = TileGrid(image.shape[1], image.shape[0], tile_size)
    if max(image.shape) > MAX_TEXTURE_SIDE or grid.rows * grid.columns > MAX_TILES:
        raise ImageError(f'"{source.name}" has {grid.width} x {grid.height} pixels, too many for tiles of {tile_size}; use larger tiles.')
    if source.role not in ROLES:
        raise ImageError(f'"{source.name}" has the role "{source.role}"; known are {", ".join(ROLES)}.')
    if not np.isin(source.mesh.materials, source.materials).any():
        raise ImageError(f'"{source.name}" is used by no triangle of the mesh; leave it out.')
    return grid


def find_used_texels(source: TextureSource, grid: TileGrid) -> np.ndarray:
    """Return which texels of the padded texture triangles show, (H', W') bool, row 0 at the top: those within MARGIN of one.

    A texture that repeats often is used wherever it is.
    """
    corners = texel_corners(source, grid)
    size = np.array([grid.width, grid.height])
    used = np.zeros(grid.padded_shape, bool)
    periods = corners.reshape(-1, 2) / size
    first, last = np.floor(periods.min(axis=0)).astype(np.int64), np.ceil(periods.max(axis=0)).astype(np.int64)
    if (last - first).prod() > MAX_PERIODS:
        used[: grid.height, : grid.width] = True
        return used
    flat = np.zeros(grid.width * grid.height, bool)
    for x in range(first[0], last[0]):
        for y in range(first[1], last[1]):
            for _, pixels, _ in rasterize(corners - size * [x, y], (grid.width, grid.height)):
                flat[pixels] = True
    inside = flat.reshape(grid.height, grid.width)
    ends = np.floor(corners.reshape(-1, 2)).astype(np.int64) % size  # The texels of triangles between the centers of texels.
    inside[ends[:, 1], ends[:, 0]] = True
    used[: grid.height, : grid.width] = maximum_filter(inside, 2 * MARGIN + 1, mode="constant")
    return used


def texel_corners(source: TextureSource, grid: TileGrid) -> np.ndarray:
    """Return the corners (T, 3, 2) in texels, from the top left, of the triangles that use the texture."""
    rows = np.isin(source.mesh.materials, source.materials)
    return (source.mesh.corner_uvs[rows] * [1.0, -1.0] + [0.0, 1.0]) * [grid.width, grid.height]


def fill_unused(source: TextureSource, grid: TileGrid, used: np.ndarray) -> np.ndarray:
    """Return the padded texture (H', W', 3) uint8, row 0 at the top, whose texels that are not `used` (H', W') continue the others."""
    if used.all():
        return np.ascontiguousarray(source.image[::-1])
    image = np.zeros((*grid.padded_shape, 3), np.float32)
    image[: grid.height, : grid.width] = source.image[::-1]
    image[~used] = 0.0
    dilate_in_place(image, used, MARGIN)
    np.rint(image, out=image)
    return image.astype(np.uint8)


def cut_tiles(image: np.ndarray, tile_size: int) -> np.ndarray:
    """Return the tiles (N, S, S, ...) of a padded texture (H', W', ...), row by row, a copy."""
    rows, columns = image.shape[0] // tile_size, image.shape[1] // tile_size
    tiles = image.reshape(rows, tile_size, columns, tile_size, *image.shape[2:]).swapaxes(1, 2)
    return tiles.reshape(rows * columns, tile_size, tile_size, *image.shape[2:])


def join_tiles(tiles: np.ndarray, grid: TileGrid) -> np.ndarray:
    """Return the texture (H, W, ...) of `tiles` (N, S, S, ...), without padding. Inverts `cut_tiles`."""
    size = grid.tile_size
    image = tiles.reshape(grid.rows, grid.columns, size, size, *tiles.shape[3:]).swapaxes(1, 2)
    return image.reshape(*grid.padded_shape, *tiles.shape[3:])[: grid.height, : grid.width]
