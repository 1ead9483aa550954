"""Texture tiles of a synthetic aerial image for `bench_bdam.py`, and the seams between them."""

import shutil
import sys
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bdam_stores import Workplace, store_bytes
from bdam_terrains import CELL_SIZE, AerialImage
from scipy import ndimage

from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.textures.grid import TILE_SIZE, TextureGrid, count_levels
from farfield.addon.core.bdam.textures.plan import TexturePlan
from farfield.addon.core.bdam.textures.resampling import ImageSource
from farfield.addon.core.bdam.textures.store import TextureStore, write_textures
from farfield.addon.core.bdam.tree import Tree
from farfield.addon.core.imaging.coded_images import ImageFormat
from farfield.addon.core.jobs.progress import run_to_end
from lib import environment

sys.path.append(str(environment.ROOT / "tests"))

from texture_builds import build_textures, stretch_over_field, tile_uv

FORMATS: tuple[ImageFormat, ...] = ("raw", "jpeg", "webp")
POINTS_PER_EDGE = 2000
BOUNDS = {"raw": 0.0, "mean": 1.5, "99.9th": 8.0}  # Differences of values up to 255.


def create_plan(samples: int, image: ImageSource, image_format: ImageFormat) -> TexturePlan:
    """Return the plan of an image over a square field of `samples` x `samples`."""
    tree = Tree(samples, samples, int(BdamSettings().patch_size))
    pixel = (samples - 1) / image.shape[1]
    grid = TextureGrid(samples, samples, tree.side, (CELL_SIZE, CELL_SIZE), count_levels(tree.side, tree.depth, pixel))
    return TexturePlan(grid, image_format)


def build_texture_store(folder: Path, image: ImageSource, image_format: ImageFormat) -> Path:
    """Build the tiles of a square image with two pixels per cell; return the folder of the store."""
    samples = image.shape[1] // 2 + 1
    out = folder / image_format
    if not out.exists():
        work = folder / f"{image_format}-work"
        plan = create_plan(samples, image, image_format)
        build_textures(work, plan, [stretch_over_field(image, samples, samples)])
        out.mkdir(parents=True)
        run_to_end(write_textures(work, plan, out))
        shutil.rmtree(work)
    return out


def measure_seams(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Compare the colors of neighboring tiles at points of their common edges, of one level, and of two as a cut may have them."""
    pixels = min(2 * (given.size - 1), 4096)
    figures: dict[str, Any] = {"pixels": pixels, "bounds": BOUNDS}
    for image_format in FORMATS:
        folder = build_texture_store(workplace.folder / f"textures-{pixels}", AerialImage(pixels, given.seed), image_format)
        with TextureStore(folder) as store:
            rows = {}
            for name, level_difference in (("same_level", 0), ("one_level_apart", 1)):
                differences = list(compare_edges(store, level_difference))
                rows[name] = summarize(np.concatenate(differences)) if differences else None
        figures[image_format] = rows | {"bytes_per_texel": round(store_bytes(folder) / pixels**2, 3)}
    return figures


def compare_edges(store: TextureStore, level_difference: int) -> Iterator[np.ndarray]:
    """Yield the absolute differences (N, 3) of the colors along the edges between the tiles of a level and tiles of the same or of the next
    coarser one."""
    grid = store.grid
    for level in range(level_difference, grid.level_count):
        for i, j in store.index.tiles[store.index.numbers(level)].tolist():
            for di, dj in ((1, 0), (0, 1)):
                other = np.array([[i + di, j + dj]]) >> level_difference
                if level_difference and (other[0] == [i >> 1, j >> 1]).all():
                    continue  # no edge of the coarser tile
                numbers = [int(store.index.find(*tile)[0]) for tile in ((level, np.array([[i, j]])), (level - level_difference, other))]
                if min(numbers) < 0:
                    continue
                side = grid.size / 2**level
                along = np.linspace(0.0, side, POINTS_PER_EDGE)
                x, y = (side * (i + 1) + 0 * along, side * j + along) if di else (side * i + along, side * (j + 1) + 0 * along)
                is_inside = (x <= grid.extent[0]) & (y <= grid.extent[1])
                points = np.stack([x, y], axis=1)[is_inside]
                first = sample(store, numbers[0], tile_uv(grid, level, (i, j), points))
                second = sample(store, numbers[1], tile_uv(grid, level - level_difference, tuple(other[0]), points))
                yield np.abs(first - second)


def sample(store: TextureStore, number: int, uvs: np.ndarray) -> np.ndarray:
    """Return the bilinear colors (N, 3) float64, 0 to 255, of a tile."""
    texels = store.read(number)[..., :3].astype(np.float64)
    places = (uvs * TILE_SIZE - 0.5)[:, ::-1].T
    return np.stack([ndimage.map_coordinates(texels[..., channel], places, order=1, mode="nearest") for channel in range(3)], axis=1)


def summarize(differences: np.ndarray) -> dict[str, float]:
    """Return the mean, the 99.9th percentile and the largest of differences."""
    return {
        "mean": round(float(differences.mean()), 3),
        "99.9th": round(float(np.percentile(differences, 99.9)), 3),
        "max": round(float(differences.max()), 3),
    }
