"""Building the texture quadtree bottom-up, tile by tile, out of core (section 5.3).

A folder holds the work of an unfinished build. Each tile is built by itself: one of the finest level from the images, any other one from
the pieces of the level below, which are the tiles without their overlap, halved. For tile (t, i, j) the folder contains

- `t-i-j.tile`: a file of blocks with the coded tile and its detail; no block if the tile has no known texel. It marks the tile as built.
- `t-i-j.piece`: (252, 252, 3 or 4) uint8 as a file of blocks, needed until level t - 1 is built; none for an empty tile.

Tiles of one level do not depend on each other, so they can be spread in any way, and give the same bytes. An interrupted build goes on with
the tiles that are missing; damaged files are built again.
"""

import uuid
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.atomic_write import TEMPORARY_SUFFIX
from ...files.blocks import BlockReader, BlockWriter
from ...files.file_access import convert_os_errors
from .filtering import EXTENSION, extend_colors, halve, measure_detail
from .grid import BORDER, STEP, TILE_SIZE, TextureGrid
from .plan import TexturePlan
from .resampling import PlacedImage, resample
from .tile_blocks import encode_tile
from .tile_index import morton_keys

MARGIN = BORDER + EXTENSION  # texels around a tile's own square that its texels depend on
WINDOW = STEP + 2 * MARGIN
PIECE = STEP // 2
OWN = slice(MARGIN, MARGIN + STEP)  # the tile's own square in a window
REACHED = slice(MARGIN - 1, MARGIN + STEP + 1)  # by bilinear interpolation within the tile's own square
TILE = slice(EXTENSION, EXTENSION + TILE_SIZE)
TILE_KIND, PIECE_KIND = "TILE", "PIECE"


def list_tiles(grid: TextureGrid, level: int) -> np.ndarray:
    """Return the tiles (N, 2) int32, columns i and j, of a level that have a part of the field, along Morton's curve: near tiles are near
    in files."""
    columns, rows = grid.tile_counts(level)
    tiles = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(np.int32)
    return tiles[np.argsort(morton_keys(tiles), kind="stable")]


def missing_tiles(folder: Path, grid: TextureGrid, level: int) -> np.ndarray:
    """Return the tiles (N, 2) of `list_tiles` that must be built, again if their files are damaged, or if their pieces are and a coarser
    tile is missing."""
    needs_pieces = False
    for coarser in range(level + 1):
        tiles = list_tiles(grid, coarser)
        is_missing = [not _is_built(folder, coarser, i, j, needs_pieces) for i, j in tiles.tolist()]
        needs_pieces = any(is_missing)
    return tiles[is_missing]


def build_tiles(
    folder: Path, plan: TexturePlan, level: int, tiles: np.ndarray, images: Sequence[PlacedImage] = (), mask: PlacedImage | None = None
) -> None:
    """Build tiles of a level, in any order and by any number of processes at once.

    Args:
        folder: the folder of the build.
        plan: what is built.
        level: all tiles of the finer level must be built.
        tiles: (N, 2) integers, i and j.
        images: needed by the finest level only; later ones lie over earlier ones.
        mask: see `resampling.resample`; needed by the finest level only.

    Raises:
        FileError: an image or a piece cannot be read, or a file cannot be written.
    """
    for i, j in np.asarray(tiles).tolist():
        _build_tile(folder, plan, level, i, j, images, mask)


def discard_pieces(folder: Path, level: int) -> None:
    """Delete the pieces of a level, once the next coarser one is built. Raises FileError."""
    with convert_os_errors(f'Cannot delete files in "{folder}"'):
        for path in folder.glob(f"{level}-*.piece"):
            path.unlink()


def tile_path(folder: Path, level: int, i: int, j: int) -> Path:
    """Return the path of the file that marks a tile as built."""
    return folder / f"{level}-{i}-{j}.tile"


def _build_tile(
    folder: Path, plan: TexturePlan, level: int, i: int, j: int, images: Sequence[PlacedImage], mask: PlacedImage | None
) -> None:
    grid = plan.grid
    columns, rows = (np.arange(STEP * number - MARGIN, STEP * (number + 1) + MARGIN) for number in (i, j))
    is_finest = level == grid.level_count - 1
    window = resample(grid, level, columns, rows, images, mask) if is_finest else _join_pieces(folder, grid, level, i, j)
    path = tile_path(folder, level, i, j)
    if not window[REACHED, REACHED, 3].any():
        _write_blocks(path, TILE_KIND, [])
        return
    blocks = [encode_tile(extend_colors(window)[TILE, TILE], window[TILE, TILE, 3], plan.image_format, plan.coding_quality)]
    if level:
        own, weights = window[OWN, OWN], (grid.inside(level, 1, rows[OWN]), grid.inside(level, 0, columns[OWN]))
        _write_blocks(path.with_suffix(".piece"), PIECE_KIND, [_pack_piece(halve(own, *weights))])
        if plan.error == "feature":
            blocks.append(np.array(measure_detail(own), "<f4").tobytes())
    _write_blocks(path, TILE_KIND, blocks)


def _join_pieces(folder: Path, grid: TextureGrid, level: int, i: int, j: int) -> np.ndarray:
    """Return the window (WINDOW, WINDOW, 4) uint8 of a tile, put together from the pieces of up to 16 tiles below."""
    joined = np.zeros((4 * PIECE, 4 * PIECE, 4), np.uint8)  # the four children, and as much again around them
    counts = grid.tile_counts(level + 1)
    for row in range(4):
        for column in range(4):
            child = 2 * i - 1 + column, 2 * j - 1 + row
            if min(child) >= 0 and child[0] < counts[0] and child[1] < counts[1]:
                target = joined[row * PIECE :, column * PIECE :][:PIECE, :PIECE]
                _read_piece(folder, level + 1, *child, target)
    last = [count - 1 for count in grid.texel_counts(level)]
    places = []
    for number, end in zip((i, j), last, strict=True):  # beyond the field the texels on its border are repeated
        texels = np.clip(np.arange(STEP * number - MARGIN, STEP * (number + 1) + MARGIN), 0, end)
        places.append(texels - (STEP * number - PIECE))
    return joined[places[1][:, None], places[0]]


def _pack_piece(piece: np.ndarray) -> bytes:
    """Return a piece as bytes, without alpha where it is 255."""
    is_opaque = bool((piece[..., 3] == 255).all())
    return np.ascontiguousarray(piece[..., :3] if is_opaque else piece).tobytes()


def _read_piece(folder: Path, level: int, i: int, j: int, target: np.ndarray) -> None:
    """Copy the piece of a tile to `target` (PIECE, PIECE, 4); leave it as it is for an empty tile."""
    path = tile_path(folder, level, i, j)
    label = f"texture tile {level}/{i}/{j}"
    with BlockReader(path, TILE_KIND) as tile:
        if not len(tile):
            return
    with BlockReader(path.with_suffix(".piece"), PIECE_KIND) as reader:
        pixels = np.frombuffer(reader.read(0, label), np.uint8).reshape(PIECE, PIECE, -1)
    target[..., 3] = 255
    target[..., : pixels.shape[2]] = pixels


def _is_built(folder: Path, level: int, i: int, j: int, with_piece: bool) -> bool:
    """Whether the file of a tile is complete, and that of its piece unless the tile is empty or `with_piece` is false."""
    path = tile_path(folder, level, i, j)
    count = _count_intact_blocks(path, TILE_KIND)
    return count == 0 or (count > 0 and (not with_piece or _count_intact_blocks(path.with_suffix(".piece"), PIECE_KIND) == 1))


def _count_intact_blocks(path: Path, kind: str) -> int:
    """Return the number of blocks of a file, -1 if it does not exist or is damaged."""
    if not path.is_file():
        return -1
    try:
        with BlockReader(path, kind) as reader:
            return -1 if any(True for _ in reader.verify()) else len(reader)
    except FileError:
        return -1


def _write_blocks(path: Path, kind: str, blocks: list[bytes]) -> None:
    """Write a file of blocks that appears at `path` complete. It is not forced to the disk: a checksum tells whether it got there."""
    temporary = path.with_name(f"{path.name}.{uuid.uuid4().hex}{TEMPORARY_SUFFIX}")  # two workers may build the same tile
    with BlockWriter(temporary, kind) as writer:
        for block in blocks:
            writer.append(block)
        writer.finish()
    with convert_os_errors(f'Cannot write "{path}"'):
        temporary.replace(path)
