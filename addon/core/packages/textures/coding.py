"""One texture, coded: variants of all tiles of its pyramid, with their bytes and what viewers notice of their errors; and
textures as pixels again, in any state."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from ...imaging.mipmaps import build_mipmaps
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps
from ..increments import Increments
from ..manifest import PackageTexture
from ..tile_pyramid import TilePyramid, sum_tiles
from .avif_files import decode_tile, encode_tile
from .enlarging import enlarge, sharpen_for_enlarging
from .texture_errors import SMALLER_SIZES, TextureErrors, encode_bytes, values_of_bytes
from .texture_tiles import TextureSource, TileGrid, cut_tiles, fill_unused, find_used_texels, join_tiles
from .visibility import BLOCK

MISSING = 128  # Value of all channels of missing tiles.
FEW_TILES = 2  # Levels with so few tiles have all variants, since one tile is much there; others have the COMMON ones.
# Levels finer than images show have three and two variants up to these numbers of tiles; details matter little there.
FINER_TILES = (8, 16)
ROLE_QUALITIES = {"roughness": 0.5, "metallic": 0.5, "occlusion": 0.5}  # Quality of data that change images less, relative to colors.
MIN_VISIBILITY = 1e-3  # Visibility of blocks that no view shows, relative to the mean of the used ones.


class Variant(NamedTuple):
    """How a tile can be coded. fraction: of the quality of complete textures. is_sharpened: by `sharpen_for_enlarging`, for more bytes,
    which are worth it where details are everywhere; level 0 is not enlarged."""

    fraction: float
    is_sharpened: bool


COMMON = (Variant(0.4, False), Variant(0.4, True), Variant(0.7, True), Variant(1.0, False))  # Variants of all levels.
VARIANTS = (*COMMON, Variant(0.55, False), Variant(0.7, False), Variant(1.0, True))
COMPLETE = 3  # index of the variant of complete textures
UNSHARPENED = (0, 5, COMPLETE)  # indices of variants of levels that images do not show enlarged


class CodedTile(NamedTuple):
    """A tile: the index of its header, and its payload."""

    header: int
    payload: bytes


@dataclass(frozen=True, eq=False)
class CodedTexture:
    """A texture with L levels of tiles in V = len(VARIANTS) variants.

    Attributes:
        texture: with the headers.
        pyramid: of tiles, of which level 0 has R rows and C columns.
        used: (R, C) bool, which of those triangles show.
        tiles: by level, variant and number, of those that triangles show and variants that a level has.
        sizes: for each level (V, R', C') bytes.
        errors: (L, V, R, C), of all tiles of level 0 if they are shown so: mean FLIP error of their pixels, times the fraction of all
            pixels of the object that they are; infinite where a level does not have the variant.
        smaller_errors: (SMALLER_SIZES, L, V, R, C), the same where the object is smaller in the image, each time half as large.
    """

    texture: PackageTexture
    pyramid: TilePyramid
    used: np.ndarray
    tiles: dict[tuple[int, int, int], CodedTile]
    sizes: list[np.ndarray]
    errors: np.ndarray
    smaller_errors: np.ndarray

    @cached_property
    def tile_errors(self) -> list[np.ndarray]:
        """For each level the errors (V, R', C') of its tiles."""
        return [sum_tiles(errors, level) for level, errors in enumerate(self.errors)]

    @cached_property
    def used_tiles(self) -> list[np.ndarray]:
        """For each level which tiles (R', C') bool triangles show."""
        return [sum_tiles(self.used.astype(np.int64), level) > 0 for level in range(len(self.sizes))]


def code_texture(
    source: TextureSource, grid: TileGrid, visibility: np.ndarray, quality: int, pixels_per_degree: float
) -> Steps[CodedTexture]:
    """Code a texture.

    Args:
        visibility: (rows, columns, FOOTPRINT_LEVELS) of blocks, see `measure_visibility`.
    """
    pyramid, blocks = TilePyramid(grid.width, grid.height, grid.tile_size), grid.tile_size // BLOCK
    used = find_used_texels(source, grid)
    image = fill_unused(source, grid, used)
    has_colors = bool((image[..., 1:] != image[..., :1]).any())
    shown = _complete_visibility(visibility, cut_blocks(used))
    used_tiles = cut_tiles(used, grid.tile_size).any(axis=(1, 2)).reshape(pyramid.shapes[0])
    del used
    mipmaps = build_mipmaps(image, values_of_bytes(source.role))
    judge = TextureErrors(source.role, mipmaps, shown, pixels_per_degree)
    errors = np.full((1 + SMALLER_SIZES, len(pyramid.shapes), len(VARIANTS), *pyramid.shapes[0]), np.inf)
    role_quality = ROLE_QUALITIES.get(source.role, 1.0) * quality
    headers: dict[bytes, int] = {}
    tiles: dict[tuple[int, int, int], CodedTile] = {}
    sizes = []
    for level, shape in enumerate(pyramid.shapes):
        width, height = (int(size) for size in mipmaps.sizes[level])
        side = pyramid.side(level)
        chosen = np.flatnonzero(sum_tiles(used_tiles.astype(np.int64), level))
        indices = _choose_variants(level, judge.finest, len(chosen), side == grid.tile_size)
        byte_counts = np.zeros((len(VARIANTS), shape[0] * shape[1]), np.int64)
        if indices:
            pixels = image if level == 0 else encode_bytes(source.role, mipmaps.level(level))
            padding = [(0, shape[0] * side - height), (0, shape[1] * side - width), (0, 0)]
            plain = cut_tiles(np.pad(pixels if has_colors else pixels[..., :1], padding, mode="edge"), side)
            sharpened = sharpen_for_enlarging(plain) if level and any(VARIANTS[index].is_sharpened for index in indices) else plain
        for position, index in enumerate(indices):
            variant = VARIANTS[index]
            cut = sharpened if variant.is_sharpened else plain
            code = partial(_code_tile, cut if has_colors else cut[..., 0], max(round(variant.fraction * role_quality), 1))
            decoded = np.full((len(cut), side, side, 3), MISSING, np.uint8)
            for count, (number, header, payload, result) in enumerate(map_ordered(code, chosen.tolist())):
                done = (position + count / len(chosen)) / len(indices)
                yield Progress(1.0 - 0.25**level * (1.0 - 0.75 * done), "Coding textures")
                tiles[level, index, number] = CodedTile(headers.setdefault(header, len(headers)), payload)
                byte_counts[index, number] = len(payload)
                decoded[number] = result
            coarse = join_tiles(decoded, TileGrid(width, height, side))
            errors[:, level, index] = _sum_blocks(judge.measure(coarse, level), blocks)
        sizes.append(byte_counts.reshape(len(VARIANTS), *shape))
    texture = PackageTexture(source.role, grid.width, grid.height, grid.tile_size, tuple(headers))
    return CodedTexture(texture, pyramid, used_tiles, tiles, sizes, errors[0], errors[1:])


def _choose_variants(level: int, finest: int, tiles: int, is_full_size: bool) -> Sequence[int]:
    """Return the indices of the variants of a level, which has so many used tiles, of full size (`is_full_size`) or halved.
    finest: the finest level that counts in images. For fewer bytes than finer levels have at the highest quality, coarser ones are better;
    but where tiles are few, there are others of lower quality between them."""
    if level < finest:
        count = 3 - sum(tiles > most for most in FINER_TILES)
        return UNSHARPENED[-count:] if count > 1 or level in (0, finest - 1) else ()
    if level == 0:
        return UNSHARPENED
    return range(len(VARIANTS) if tiles <= FEW_TILES and is_full_size else len(COMMON))


def cut_blocks(used: np.ndarray) -> np.ndarray:
    """Return which blocks (H / 8, W / 8) have used texels. used: (H, W) bool."""
    rows, columns = used.shape[0] // BLOCK, used.shape[1] // BLOCK
    return used.reshape(rows, BLOCK, columns, BLOCK).any(axis=(1, 3))


def _code_tile(tiles: np.ndarray, quality: int, number: int) -> tuple[int, bytes, bytes, np.ndarray]:
    """Return the number of a tile, its header and payload, and its decoded pixels."""
    header, payload = encode_tile(tiles[number], quality)
    return number, header, payload, decode_tile(header, payload, tiles.shape[1])


def _sum_blocks(errors: np.ndarray, blocks: int) -> np.ndarray:
    """Return the sums (N, R, C) over tiles of level 0, whose sides have so many `blocks`. errors: (N, H / 8, W / 8)."""
    rows, columns = errors.shape[1] // blocks, errors.shape[2] // blocks
    return errors.reshape(-1, rows, blocks, columns, blocks).sum(axis=(2, 4))


def _complete_visibility(visibility: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return `visibility` with a small one, spread over resolutions as that of all, of blocks that are `used` but not seen."""
    total = visibility.sum(axis=2)
    common = visibility.sum(axis=(0, 1), dtype=np.float64)
    common = common / common.sum() if common.any() else np.full(len(common), 1.0 / len(common))
    floor = MIN_VISIBILITY * max(float(total.sum()) / max(int(used.sum()), 1), 1e-9)
    return visibility + (np.where(used, np.maximum(floor - total, 0.0), 0.0)[..., None] * common).astype(np.float32)


def decode_textures(
    textures: Sequence[PackageTexture], increments: Increments, content: bytes | memoryview, state: int | None = None
) -> list[np.ndarray]:
    """Return the textures (H, W, 3) uint8, row 0 at the bottom, that a state has, the last one by default.

    content: the bytes of the increments, one after the other.

    Raises:
        FileError: a tile is damaged.
    """
    parts = increments.split(content)
    is_shown = increments.are_in(increments.state_count - 1 if state is None else state)
    images = []
    for index, texture in enumerate(textures):
        side, pyramid = texture.tile_size, TilePyramid(texture.width, texture.height, texture.tile_size)
        tiles = np.full((*pyramid.shapes[0], side, side, 3), MISSING, np.uint8)
        show = partial(_show_increment, tiles, texture, pyramid, increments, parts)
        for _ in map_ordered(show, np.flatnonzero((increments.textures == index) & is_shown).tolist()):
            pass
        images.append(join_tiles(tiles.reshape(-1, side, side, 3), TileGrid(texture.width, texture.height, side))[::-1])
    return images


def _show_increment(
    tiles: np.ndarray, texture: PackageTexture, pyramid: TilePyramid, increments: Increments, parts: Sequence[memoryview], number: int
) -> None:
    """Write the pixels of an increment to `tiles` (R, C, S, S, 3) uint8."""
    level, row, column = pyramid.locate(int(increments.tiles[number]))
    coded = decode_tile(texture.headers[int(increments.headers[number])], parts[number], pyramid.side(level))
    enlarged = enlarge(coded, level)
    side = texture.tile_size
    count = len(enlarged) // side
    found = enlarged.reshape(count, side, count, side, 3).swapaxes(1, 2)
    shown = tiles[pyramid.covered(level, row, column)]
    shown[:] = found[: shown.shape[0], : shown.shape[1]]
