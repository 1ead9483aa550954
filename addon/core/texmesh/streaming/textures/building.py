"""The textures of a package: from images and the mesh that shows them to headers, increments and their order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....jobs.progress import Steps, subprogress
from ..increments import Increments
from ..manifest import PackageTexture
from .coding import CodedTexture, code_texture
from .queue import MAX_GAIN, order_increments
from .settings import TextureSettings
from .texture_tiles import TextureSource, check_source
from .visibility import measure_visibility

GAIN_UNIT = 1e-6  # of Increments.gains


@dataclass(frozen=True, eq=False)
class BuiltTextures:
    """The textures of a package.

    textures: in the order of the sources. increments: in their order. content: the bytes of all increments, one after the other.
    flips: (N + 1,) float64, the predicted mean FLIP error of the object's pixels due to the textures, with the first 0 to N increments.
    """

    textures: tuple[PackageTexture, ...]
    increments: Increments
    content: bytes
    flips: np.ndarray


def build_textures(sources: Sequence[TextureSource], settings: TextureSettings) -> Steps[BuiltTextures]:
    """Code textures as tiles, and order their scans. The same sources give the same bytes.

    Raises:
        ImageError: a source cannot be coded, see `check_source`.
    """
    grids = [check_source(source, settings.tile_size) for source in sources]
    visibility = yield from subprogress(measure_visibility(sources, grids, settings.views, settings.pixels), 0.0, 0.3)
    coded = []
    for index, (source, grid) in enumerate(zip(sources, grids, strict=True)):
        start, stop = (0.3 + 0.7 * (index + step) / len(sources) for step in (0, 1))
        coded.append((yield from subprogress(code_texture(source, grid, visibility[index], settings), start, stop)))
    return _assemble(coded)


def _assemble(coded: Sequence[CodedTexture]) -> BuiltTextures:
    """Order the scans of all tiles of all textures."""
    count = max(item.sizes.shape[1] for item in coded)
    sizes = np.concatenate([np.pad(item.sizes, ((0, 0), (0, count - item.sizes.shape[1]))) for item in coded])
    errors = np.concatenate([np.pad(item.errors, ((0, 0), (0, count + 1 - item.errors.shape[1])), mode="edge") for item in coded])
    contents = [scans for item in coded for scans in item.contents]
    owners = np.repeat(np.arange(len(coded)), [len(item.tiles) for item in coded])
    queued = order_increments(sizes, errors)
    scan_counts = np.array(
        [
            np.count_nonzero(sizes[row, first : first + number])
            for row, first, number in zip(queued.rows, queued.first_scans, queued.scan_counts, strict=True)
        ],
        np.int64,
    )
    parts = [
        b"".join(contents[row][first : first + number])
        for row, first, number in zip(queued.rows.tolist(), queued.first_scans.tolist(), queued.scan_counts.tolist(), strict=True)
    ]
    gains = np.minimum(queued.gains / GAIN_UNIT, MAX_GAIN).astype(np.float16)
    increments = Increments(
        owners[queued.rows],
        np.concatenate([item.tiles for item in coded])[queued.rows],
        np.concatenate([item.headers for item in coded])[queued.rows],
        scan_counts,
        np.array([len(part) for part in parts], np.int64),
        gains,
    )
    flips = errors[:, 0].sum() - np.concatenate([[0.0], np.cumsum(queued.gains)])
    return BuiltTextures(tuple(item.texture for item in coded), increments, b"".join(parts), flips)
