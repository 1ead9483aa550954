"""The textures of a package: from images and the mesh that shows them to headers, increments and their order."""

import io
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat

import numpy as np

from ....jobs.progress import Progress, Steps, subprogress
from ..increments import Increments
from ..manifest import PackageTexture
from .progressive_files import decode_tile, split_scans
from .queue import MAX_GAIN, order_increments
from .settings import TextureSettings
from .texture_tiles import TextureSource, check_source, cut_tiles, fill_unused, find_used_texels
from .visibility import BLOCK, measure_visibility

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


def build_textures(sources: Sequence[TextureSource], settings: TextureSettings, threads: int = 2) -> Steps[BuiltTextures]:
    """Code textures as tiles, and order their scans. The same sources give the same bytes.

    Raises:
        ImageError: a source cannot be coded, see `check_source`.
    """
    grids = [check_source(source, settings.tile_size) for source in sources]
    visibility = yield from subprogress(measure_visibility(sources, grids, settings.views, settings.pixels), 0.0, 0.3)
    textures, owners, tiles, contents, errors = [], [], [], [], []
    for index, (source, grid) in enumerate(zip(sources, grids, strict=True)):
        yield Progress(0.3 + 0.7 * index / len(sources), "Coding textures")
        used = find_used_texels(source, grid)
        pixels = cut_tiles(fill_unused(source, grid, used), settings.tile_size)
        is_used = cut_tiles(used, settings.tile_size).any(axis=(1, 2))
        weights = cut_tiles(visibility[index].sum(axis=2), settings.tile_size // BLOCK).sum(axis=(1, 2))
        numbers = np.flatnonzero(is_used)

        with ThreadPoolExecutor(threads) as pool:
            coded = list(pool.map(_code_tile, pixels[numbers], repeat(settings.quality), (weights[numbers] + 1e-9).tolist()))
        textures.append(PackageTexture(source.role, grid.width, grid.height, settings.tile_size, (coded[0][0],)))
        owners += [index] * len(numbers)
        tiles += numbers.tolist()
        contents += [scans for _, scans, _ in coded]
        errors += [values for _, _, values in coded]
    return _assemble(textures, np.array(owners), np.array(tiles), contents, errors)


def _code_tile(pixels: np.ndarray, quality: int, weight: float) -> tuple[bytes, list[bytes], list[float]]:
    """Return the header of a tile, its scans, and its errors without and with the first ones."""
    from PIL import Image  # here, so that importing the core needs only NumPy and SciPy

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality, progressive=True, subsampling=0)
    header, scans = split_scans(file.getvalue())
    decoded = [np.full(pixels.shape, 128, np.uint8), *(decode_tile(header, scans[: k + 1])[::-1] for k in range(len(scans)))]
    return header, scans, [weight * float(np.sqrt(np.mean((image.astype(np.float32) - pixels) ** 2))) / 255.0 for image in decoded]


def _assemble(
    textures: list[PackageTexture], owners: np.ndarray, tiles: np.ndarray, contents: list[list[bytes]], errors: list[list[float]]
) -> BuiltTextures:
    """Order the scans of all tiles."""
    count = max(len(scans) for scans in contents)
    sizes = np.array([[len(scan) for scan in scans] + [0] * (count - len(scans)) for scans in contents])
    padded = np.array([values + [values[-1]] * (count + 1 - len(values)) for values in errors])
    queued = order_increments(sizes, padded)
    parts = [
        b"".join(contents[row][first : first + number])
        for row, first, number in zip(queued.rows.tolist(), queued.first_scans.tolist(), queued.scan_counts.tolist(), strict=True)
    ]
    gains = np.minimum(queued.gains / GAIN_UNIT, MAX_GAIN).astype(np.float16)
    increments = Increments(
        owners[queued.rows],
        tiles[queued.rows],
        np.zeros(len(parts), np.int64),
        queued.scan_counts,
        np.array([len(part) for part in parts], np.int64),
        gains,
    )
    flips = padded[:, 0].sum() - np.concatenate([[0.0], np.cumsum(queued.gains)])
    return BuiltTextures(tuple(textures), increments, b"".join(parts), flips)
