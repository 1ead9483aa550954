"""The textures of a package: from images and the mesh that shows them to headers, increments and their order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...jobs.progress import Steps, subprogress
from ..increments import Increments
from ..manifest import PackageTexture
from ..settings import PackageSettings
from .best_state import measure_error, measure_smaller_errors
from .coding import CodedTexture, code_texture
from .texture_errors import SMALLER_SIZES
from .texture_tiles import TextureSource, check_source
from .tile_states import choose_states, order_tiles
from .visibility import measure_visibility

VIEWS = 24  # from all around


@dataclass(frozen=True, eq=False)
class BuiltTextures:
    """The textures of a package.

    textures: in the order of the sources. increments: in their order. content: the bytes of all increments, one after the other.
    flips: (K, 1 + SMALLER_SIZES) float64, the predicted mean FLIP error of the object's pixels due to the textures in each state, and where
    the object is half as large in the image, a quarter, and so on.
    """

    textures: tuple[PackageTexture, ...]
    increments: Increments
    content: bytes
    flips: np.ndarray


NO_TEXTURES = BuiltTextures((), Increments(*[np.zeros(0, np.int64)] * 6), b"", np.zeros((1, 1 + SMALLER_SIZES)))


def build_textures(
    sources: Sequence[TextureSource], settings: PackageSettings, pixels_per_degree: float, views: int = VIEWS
) -> Steps[BuiltTextures]:
    """Code textures as tiles, and order them. The same sources give the same bytes.

    Args:
        pixels_per_degree: of the display. views: from all around, in which the visibility of textures is measured.

    Raises:
        ImageError: a source cannot be coded, see `check_source`.
    """
    if not sources:
        return NO_TEXTURES
    return assemble_textures((yield from code_textures(sources, settings, pixels_per_degree, views)))


def code_textures(
    sources: Sequence[TextureSource], settings: PackageSettings, pixels_per_degree: float, views: int = VIEWS
) -> Steps[list[CodedTexture]]:
    """Code textures as tiles.

    Raises:
        ImageError: see `build_textures`.
    """
    grids = [check_source(source, settings.tile_size) for source in sources]
    visibility = yield from subprogress(measure_visibility(sources, grids, views, settings.pixels), 0.0, 0.3)
    coded = []
    for index, (source, grid) in enumerate(zip(sources, grids, strict=True)):
        start, stop = (0.3 + 0.7 * (index + step) / len(sources) for step in (0, 1))
        coded.append(
            (yield from subprogress(code_texture(source, grid, visibility[index], settings.quality, pixels_per_degree), start, stop))
        )
    return coded


def assemble_textures(coded: Sequence[CodedTexture]) -> BuiltTextures:
    """Choose states of textures, and join their tiles in the order of the file."""
    states = choose_states(coded)
    ordered = order_tiles(states)
    tiles, numbers = [], []
    for choice in ordered.choices:
        pyramid = coded[choice.texture].pyramid
        number = choice.row * pyramid.shapes[choice.level][1] + choice.column
        numbers.append(int(pyramid.starts[choice.level]) + number)
        tiles.append(coded[choice.texture].tiles[choice.level, choice.variant, number])
    increments = Increments(
        np.array([choice.texture for choice in ordered.choices], np.int64),
        np.array(numbers, np.int64),
        np.array([tile.header for tile in tiles], np.int64),
        np.array([len(tile.payload) for tile in tiles], np.int64),
        ordered.firsts,
        ordered.lasts,
    )
    flips = np.array([[measure_error(coded, state), *measure_smaller_errors(coded, state)] for state in states])
    return BuiltTextures(tuple(item.texture for item in coded), increments, b"".join(tile.payload for tile in tiles), flips)
