"""Tiny stores of large terrain, built from arrays in this process in about half a second."""

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.structure import read_structure, write_structure
from farfield.addon.core.bdam.store.terrain_store import TEXTURE_FOLDER, TerrainStore
from farfield.addon.core.bdam.textures.grid import TextureGrid, count_levels
from farfield.addon.core.bdam.textures.plan import TexturePlan
from farfield.addon.core.bdam.textures.store import write_textures
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.cut_meshes import CutMesh, merge_patches
from farfield.addon.core.bdam.view.extraction import Cut
from farfield.addon.core.geometry.placements import ProjectedFrame
from farfield.addon.core.jobs.progress import run_to_end
from shared_results import make_once
from texture_builds import build_textures, stretch_over_field

CELL_SIZE = 10.0


@dataclass(frozen=True, eq=False)
class ArrayField:
    """A field of heights (rows, columns) in meters, NaN where unknown, with its local zero at the sample nearest to the center."""

    heights: np.ndarray
    cell_size: float = CELL_SIZE
    height_step: float | None = None
    crs: str = "meters"
    warnings: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        return self.heights.shape

    @property
    def frame(self) -> ProjectedFrame:
        rows, columns = self.heights.shape
        center = self.cell_size * ((columns - 1) // 2), self.cell_size * ((rows - 1) // 2)
        return ProjectedFrame((0.0, 0.0), (self.cell_size, self.cell_size), center)

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        return self.heights[rows, columns].astype(np.float32)


def hills(rows: int = 129, columns: int = 129, seed: int = 1) -> np.ndarray:
    """Smooth heights (rows, columns) in meters with detail of several sizes."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float64)
    heights = np.zeros((rows, columns))
    for octave in range(5):
        frequency = 2.0**octave / 60.0
        angle, phase = random.uniform(0.0, 2.0 * np.pi, 2)
        heights += 100.0 * 0.5**octave * np.sin(2.0 * np.pi * frequency * (x * np.cos(angle) + y * np.sin(angle)) + phase)
    return heights


def colors(size: int = 1024) -> np.ndarray:
    """A photograph of the ground (size, size, 3) uint8, row 0 in the south, with detail in every place."""
    y, x = np.mgrid[0:size, 0:size]
    return np.stack([x * 255 // size, y * 255 // size, np.where((x // 8 + y // 8) % 2, 60, 200)], axis=-1).astype(np.uint8)


def build_store(folder: Path, heights: np.ndarray, leaf: str = "16", height_step: float = 0.01) -> Path:
    """Build the store of heights (rows, columns) in `folder`, without texture. Each run builds the same store once and copies it."""

    def build(target: Path) -> None:
        settings = BdamSettings(patch_size=leaf, height_step=height_step, executor="serial", fill_holes="none", normal_maps=False)
        run_to_end(build_terrain(ArrayField(heights), [], target, settings))

    return _build_once(folder, f"{leaf} {height_step} {heights.dtype} {heights.shape}", heights, build)


def add_texture(folder: Path, image: np.ndarray, image_format: str = "jpeg") -> Path:
    """Add an image (H, W, 3 or 4) uint8, row 0 in the south, over the whole field to a store that `build_store` has built. Each run
    does so once for the same store and image, and copies the result."""
    content = b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())
    plain = folder.with_name(f"{folder.name} without texture")
    folder.rename(plain)

    def build(target: Path) -> None:
        shutil.copytree(plain, target)
        _add_texture(target, image, image_format)

    _build_once(folder, f"{hashlib.sha256(content).hexdigest()} {image_format} {image.shape}", image, build)
    shutil.rmtree(plain)
    return folder


def _build_once(folder: Path, settings: str, values: np.ndarray, build: Callable[[Path], None]) -> Path:
    """Let `build` create a folder, or copy the one that it has created in this run for the same settings and array to `folder`."""
    key = hashlib.sha256(settings.encode() + np.ascontiguousarray(values).tobytes()).hexdigest()
    shutil.copytree(make_once(f"store-{key}", build), folder)
    return folder


def _add_texture(folder: Path, image: np.ndarray, image_format: str) -> None:
    header, levels, _ = read_structure(folder)
    tree = header.tree
    placed = stretch_over_field(image, header.columns, header.rows)
    level_count = count_levels(tree.side, tree.depth, min(placed.step))
    spacing = header.step if header.frame == "projected" else (header.cell_size, header.cell_size)
    grid = TextureGrid(header.columns, header.rows, tree.side, tuple(spacing), level_count)
    work, out = folder.with_name(f"{folder.name} textures"), folder / TEXTURE_FOLDER
    out.mkdir()
    plan = TexturePlan(grid, image_format)
    build_textures(work, plan, [placed])
    run_to_end(write_textures(work, plan, out))
    write_structure(folder, replace(header, has_texture=True), levels)


def build_cut_mesh(store: TerrainStore, cut: Cut, cache: PatchCache | None = None) -> CutMesh:
    """The mesh of a whole cut."""
    cache = cache or PatchCache(store)
    return merge_patches([cache.read(key) for key in cut.list_patches()], cut.levels)
