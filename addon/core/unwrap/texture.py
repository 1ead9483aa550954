"""The texture that a UV map is made for: its size, and its UDIM tiles."""

from dataclasses import dataclass

import numpy as np

from ..geometry.transforms import signed_areas

TILES_PER_ROW = 10  # UDIM numbers: 1001 is the tile at the origin, 1002 the one to its right, 1011 the one above it.


@dataclass(frozen=True, kw_only=True)
class Texture:
    """What charts are packed into.

    Attributes:
        size: Width and height of a tile, in texels.
        margin: Texels between charts, and to the border of the tile.
        density: Texels per unit of length. 0: as many as fit.
        max_tiles: Maximum number of UDIM tiles. Where charts do not fit at `density`, it is lowered.
    """

    size: tuple[int, int] = (2048, 2048)
    margin: float = 8.0
    density: float = 0.0
    max_tiles: int = 1

    @property
    def inside(self) -> np.ndarray:
        """Width and height (2,) of a tile without the margin at its border, at least half of it, in texels."""
        size = np.array(self.size, np.float64)
        return np.maximum(size - 2.0 * self.margin, 0.5 * size)

    @property
    def area(self) -> float:
        """Texels of a tile."""
        return float(self.size[0]) * float(self.size[1])

    @property
    def aspect(self) -> np.ndarray:
        """Factors (2,) of u and v that undo the stretch of a texture that is not square, and keep areas."""
        return np.array(self.size) / np.sqrt(self.area)


def tile_origins(count: int) -> np.ndarray:
    """Return the lower left corners (count, 2) of the first tiles."""
    tiles = np.arange(count)
    return np.stack([tiles % TILES_PER_ROW, tiles // TILES_PER_ROW], axis=1)


def compute_texel_density(corner_uvs: np.ndarray, area: float, texture: Texture) -> float:
    """Return the texels per unit of length, on average, of a UV map (T, 3, 2) of a surface with this `area`; 0 without an area."""
    texels = float(np.abs(signed_areas(corner_uvs)).sum()) * texture.area
    return float(np.sqrt(texels / area)) if area > 0.0 else 0.0
