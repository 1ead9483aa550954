"""Texture tiles of images that are arrays, built in this process."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from farfield.addon.core.bdam.textures.build import build_tiles, discard_pieces, missing_tiles
from farfield.addon.core.bdam.textures.grid import BORDER, STEP, TILE_SIZE, TextureGrid
from farfield.addon.core.bdam.textures.plan import TexturePlan
from farfield.addon.core.bdam.textures.resampling import ImageSource, PlacedImage
from farfield.addon.core.bdam.textures.store import write_textures
from farfield.addon.core.jobs.progress import run_to_end


@dataclass(frozen=True, eq=False)
class ArraySource:
    """An image that is an array (H, W, 3 or 4), also a mapped one."""

    pixels: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns and channels."""
        return self.pixels.shape

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window of the array."""
        return self.pixels[rows, columns]


def stretch_over_field(image: ImageSource | np.ndarray, columns: int, rows: int) -> PlacedImage:
    """Place an image whose row 0 is the southern one over the whole field of columns x rows samples."""
    source = ArraySource(image) if isinstance(image, np.ndarray) else image
    height, width, _ = source.shape
    return PlacedImage(source, (0.0, 0.0), ((columns - 1) / width, (rows - 1) / height))


def build_textures(folder: Path, plan: TexturePlan, images: Sequence[PlacedImage], max_tiles: int | None = None) -> None:
    """Build all tiles, the finest level first, or only the first of those that are missing; goes on with an interrupted build."""
    folder.mkdir(parents=True, exist_ok=True)
    for level in reversed(range(plan.grid.level_count)):
        missing = missing_tiles(folder, plan.grid, level)
        build_tiles(folder, plan, level, missing[:max_tiles], images)
        if max_tiles is not None and len(missing):
            return
        discard_pieces(folder, level + 1)


def write_texture_store(folder: Path, plan: TexturePlan, images: Sequence[PlacedImage]) -> Path:
    """Build all tiles below a folder, and return the folder of their store."""
    build_textures(folder / "work", plan, images)
    (folder / "store").mkdir(exist_ok=True)
    run_to_end(write_textures(folder / "work", plan, folder / "store"))
    return folder / "store"


def tile_uv(grid: TextureGrid, level: int, tile: Sequence[int], positions: np.ndarray) -> np.ndarray:
    """Return the UV coordinates (N, 2) float64 of grid `positions` (N, 2) in a tile (i, j); the formula of `textures.grid`."""
    return (BORDER + STEP * (positions * (2.0**level / grid.size) - np.asarray(tile))) / TILE_SIZE
