"""The texture tiles of a finished terrain store.

`textures.tiles` is a file of blocks (`files/blocks.py`, kind TEXTURES): the tiles, coded as `tile_blocks` describes, by level from the
coarsest on and along Morton's curve. `textures.structure` is a file of blocks of kind TEXTREE:

| block | content, little-endian |
|---|---|
| 0 | JSON text: the fields of `TexturePlan` |
| 1 | levels of the tiles, N int32, ascending |
| 2 | positions of the tiles, N x 2 int32: i, j |
| 3 | own errors in meters, N float32 |
| 4 | nested errors in meters, N float32, see `tile_index` |
| 5 | CRC-32 of the index of `textures.tiles`, uint32 |

Tile n of these arrays is block n of the other file. Backups (see `files/backups.py`) are those of the index of `textures.tiles` and of the
whole `textures.structure`.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...errors import FileError, ImageError
from ...files.backups import FileDamage, copy_to_backup, read_either
from ...files.blocks import BlockReader, BlockWriter
from ...jobs.progress import Progress, Steps
from .build import TILE_KIND, list_tiles, tile_path
from .grid import TILE_SIZE, TextureGrid
from .plan import TexturePlan, parse_plan
from .tile_blocks import CodedTile, decode_tile, split_block
from .tile_index import TileIndex

TILES_FILE, STRUCTURE_FILE = "textures.tiles", "textures.structure"
PROGRESS_TILES = 128  # between two steps of `write_textures`
TILES_KIND, STRUCTURE_KIND, STRUCTURE_BLOCKS = "TEXTURES", "TEXTREE", 6
MIN_FEATURE_CONTRAST = 6.0  # contrast that counts as a feature, in units of 1/255; about twice what can be told apart
MAX_ERROR = 1e18  # meters

Decoded = TypeVar("Decoded")


def write_textures(folder: Path, plan: TexturePlan, out: Path) -> Steps[int]:
    """Write the files of a store to the existing folder `out` from the finished build of a plan in `folder`. Returns the number of tiles.

    Raises:
        FileError: a tile is missing or damaged, or a file cannot be written.
    """
    levels, tiles, details = [], [], []
    with BlockWriter(out / TILES_FILE, TILES_KIND) as writer:
        for level in range(plan.grid.level_count):
            candidates = list_tiles(plan.grid, level)
            for number, (i, j) in enumerate(candidates.tolist()):
                if number % PROGRESS_TILES == 0:
                    yield Progress((level + number / len(candidates)) / plan.grid.level_count, "Texture store")
                with BlockReader(tile_path(folder, level, i, j), TILE_KIND) as reader:
                    if not len(reader):
                        continue
                    label = f"texture tile {level}/{i}/{j}"
                    writer.append(reader.read(0, label))
                    details.append(np.frombuffer(reader.read(1, label), "<f4")[0] if len(reader) > 1 else np.inf)
                levels.append(level)
                tiles.append((i, j))
        checksum = writer.finish(backs_up_index=True)
    index = TileIndex(np.array(levels, np.int32), np.array(tiles, np.int32).reshape(-1, 2), plan.grid.level_count)
    own = measure_own_errors(index, plan.grid, np.array(details, np.float32))
    nested = index.nest(own)
    with BlockWriter(out / STRUCTURE_FILE, STRUCTURE_KIND) as writer:
        writer.append(plan.to_json())
        for array, dtype in ((index.levels, "<i4"), (index.tiles, "<i4"), (own, "<f4"), (nested, "<f4")):
            writer.append(array.astype(dtype).tobytes())
        writer.append(checksum.to_bytes(4, "little"))
        writer.finish()
    copy_to_backup(out / STRUCTURE_FILE)
    yield Progress(1.0, "Texture store written")
    return len(index)


def measure_own_errors(index: TileIndex, grid: TextureGrid, details: np.ndarray) -> np.ndarray:
    """Return the error of each tile by itself, in meters, (N,) float32.

    It is the size of the tile's texels, and 0 at the finest level and where no child has visible detail. With the nesting over descendants
    it is then the size of the largest feature that disappears when the tile replaces the finest texels: features up to that size live in
    the texels of the next finer level.

    details: (N,) float32, the contrast that each tile loses when it is replaced by its parent (`filtering.measure_detail`); inf if it was
        not measured, which gives the magnification error.
    """
    sizes = np.array([grid.texel_meters(level) for level in range(grid.level_count)], np.float32)
    parents = index.parents()
    is_visible = (details >= MIN_FEATURE_CONTRAST) & (parents >= 0)
    errors = np.zeros(len(index), np.float32)
    lossy = np.unique(parents[is_visible])
    errors[lossy] = sizes[index.levels[lossy]]
    return errors


class TextureStore(AbstractContextManager):
    """The texture tiles of a store, read by number. Threads may share it.

    Attributes:
        plan: the settings and the grid of the build.
        index: levels and positions of the tiles.
        own_errors, errors: (N,) float32, meters, without and with nesting.
        damages: damages of files that have a backup.
    """

    def __init__(self, folder: Path, kind: str = "texture tile") -> None:
        """Open the store in a folder; its tiles are not read. kind: what messages call a tile.

        Raises:
            FileError: a file is missing, damaged or of a newer version, or the two do not belong together.
        """
        self._kind, path = kind, folder / STRUCTURE_FILE
        (self.plan, self.index, self.own_errors, self.errors, checksum), damages = read_either(path, _read_structure)
        self._blocks = BlockReader(folder / TILES_FILE, TILES_KIND, has_backup=True)
        self.damages: tuple[FileDamage, ...] = (*damages, *self._blocks.damages)
        if (len(self._blocks), self._blocks.index_checksum) != (len(self.index), checksum):
            self._blocks.close()
            raise FileError(f'"{folder / TILES_FILE}" and "{STRUCTURE_FILE}" belong to different textures; build the terrain again.')

    def __exit__(self, *_error: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self.index)

    @property
    def grid(self) -> TextureGrid:
        """The layout of the tiles."""
        return self.plan.grid

    @property
    def sizes(self) -> np.ndarray:
        """The sizes in bytes of the coded tiles, (N,) uint32."""
        return self._blocks.sizes

    def label(self, number: int) -> str:
        """Return the name of a tile in messages."""
        i, j = self.index.tiles[number]
        return f"{self._kind} {self.index.levels[number]}/{i}/{j}"

    def read(self, number: int) -> np.ndarray:
        """Return a tile (512, 512, 3), or (512, 512, 4) with alpha, uint8, sRGB-encoded, straight alpha, row 0 the southern one.

        Raises:
            FileError: the tile is damaged; the message names it.
        """
        return self._decode(number, lambda block: decode_tile(block, TILE_SIZE**2))

    def read_coded(self, number: int) -> CodedTile:
        """Return a tile as the coded images that are stored; see `read`. Their headers were checked: they have a format of tiles, and at
        most TILE_SIZE by TILE_SIZE pixels."""
        return self._decode(number, lambda block: split_block(block, TILE_SIZE**2))

    def verify(self) -> Iterator[int]:
        """Yield the numbers of damaged tiles; the others can be used. Reads all tiles, and of their images the headers."""
        for number in range(len(self)):
            try:
                self.read_coded(number)
            except FileError:
                yield number

    def close(self) -> None:
        """Close the file of tiles."""
        self._blocks.close()

    def _decode(self, number: int, decode: Callable[[bytes], Decoded]) -> Decoded:
        block = self._blocks.read(number, self.label(number))
        try:
            return decode(block)
        except ImageError as error:
            raise FileError(
                f'The {self.label(number)} in "{self._blocks.path}" is damaged; build it again, or go on without it.'
            ) from error


def _read_structure(path: Path) -> tuple[TexturePlan, TileIndex, np.ndarray, np.ndarray, int]:
    """Return plan, index, own and nested errors of tiles, and the checksum of the index of their file, from a structure file or its backup.
    Raises FileError."""
    with BlockReader(path, STRUCTURE_KIND) as reader:
        if len(reader) != STRUCTURE_BLOCKS:
            raise _damaged(path)
        blocks = [reader.read(number, "structure of textures") for number in range(STRUCTURE_BLOCKS)]
    try:
        plan = parse_plan(blocks[0])
        levels, tiles = np.frombuffer(blocks[1], "<i4"), np.frombuffer(blocks[2], "<i4").reshape(-1, 2)
        own, nested = np.frombuffer(blocks[3], "<f4"), np.frombuffer(blocks[4], "<f4")
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise _damaged(path) from error
    index = TileIndex(levels, tiles, plan.grid.level_count)
    if len(blocks[5]) != 4 or {len(tiles), len(own), len(nested)} != {len(levels)} or not index.is_valid:
        raise _damaged(path)
    if not all(((errors >= 0.0) & (errors <= MAX_ERROR)).all() for errors in (own, nested)):  # NaN is not
        raise _damaged(path)
    return plan, index, own, nested, int.from_bytes(blocks[5], "little")


def _damaged(path: Path) -> FileError:
    return FileError(f'"{path}" is damaged; build it again.')
