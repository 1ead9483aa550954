"""The maps of one store that tiles show: textures, normal maps, or both, in one quadtree.

Both kinds have tiles in the same squares, down to different levels. A square of the common quadtree is covered by the tile of each kind in
it, or by a part of a tile of the finest level above it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..store.terrain_store import TerrainStore
from ..textures.grid import BORDER, STEP, TILE_SIZE
from ..textures.store import TextureStore
from ..textures.tile_blocks import CodedTile
from ..textures.tile_index import TileIndex

KINDS = ("color", "normal")


@dataclass(frozen=True)
class ShownMap:
    """A tile of one kind and the part of it that a square shows.

    Attributes:
        number: of the tile.
        coded: its image files.
        scale, offset: from the UV coordinates of the square's own tile to those of this one.
    """

    number: int
    coded: CodedTile
    scale: float
    offset: tuple[float, float]


@dataclass(frozen=True)
class ShownMaps:
    """The maps of one square, None where there is none. label: level, column and row of the square."""

    label: str
    color: ShownMap | None
    normal: ShownMap | None


class StoreMaps:
    """The quadtree of the maps of a store.

    Attributes:
        stores: the tiles by kind.
        index: the squares that have a tile of any kind.
        errors: (N,) float64, meters; the largest of the tiles in a square.
    """

    def __init__(self, store: TerrainStore, has_color: bool) -> None:
        """has_color: whether textures are shown, if the store has any."""
        found = {"color": store.textures if has_color else None, "normal": store.normals}
        self.stores: dict[str, TextureStore] = {
            kind: tiles for kind, tiles in found.items() if tiles is not None and bool((tiles.index.levels == 0).any())
        }

    @cached_property
    def index(self) -> TileIndex:
        """See the class."""
        parts = [tiles.index for tiles in self.stores.values()]
        if len(parts) == 1:
            return parts[0]
        rows = np.unique(np.concatenate([np.column_stack([part.levels, part.tiles]) for part in parts]), axis=0)
        return TileIndex(rows[:, 0], rows[:, 1:], max(part.level_count for part in parts))

    @cached_property
    def errors(self) -> np.ndarray:
        """See the class."""
        errors = np.zeros(len(self.index))
        for tiles in self.stores.values():
            places = self.index.find(tiles.index.levels, tiles.index.tiles)
            errors[places] = np.maximum(errors[places], tiles.errors)
        return errors

    def find(self, kind: str, number: int) -> tuple[int, int] | None:
        """Return the number of the tile of a kind that covers square `number`, and how many levels it is above it; None without."""
        tiles = self.stores.get(kind)
        if tiles is None:
            return None
        above = max(int(self.index.levels[number]) - (tiles.grid.level_count - 1), 0)
        found = int(tiles.index.find(int(self.index.levels[number]) - above, self.index.tiles[number][None] >> above)[0])
        return None if found < 0 else (found, above)

    def label(self, number: int) -> str:
        """Return level, column and row of a square."""
        return f"{self.index.levels[number]} {self.index.tiles[number, 0]} {self.index.tiles[number, 1]}"

    def place(self, number: int, found: tuple[int, int], coded: CodedTile) -> ShownMap:
        """Return a tile that `find` has found for square `number`, with the part of it that the square shows; see `textures.grid`."""
        scale = 0.5 ** found[1]
        start = self.index.tiles[number] * scale - (self.index.tiles[number] >> found[1])
        offset = (BORDER * (1.0 - scale) + STEP * start) / TILE_SIZE
        return ShownMap(found[0], coded, scale, tuple(offset.tolist()))
