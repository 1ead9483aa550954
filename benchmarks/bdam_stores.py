"""Stores of terrains for `bench_bdam.py`, built when they are needed first."""

import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from bdam_terrains import CELL_SIZE, FractalTerrain

from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, open_field
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.cut_meshes import CutMesh, merge_patches
from farfield.addon.core.bdam.view.extraction import Cut
from farfield.addon.core.jobs.progress import run_to_end


@dataclass
class Workplace:
    """A folder for elevation models and stores.

    executor: of builds. costs: seconds of the builds by name. texture: the figures of the last build of textures.
    """

    folder: Path
    executor: str
    costs: dict[str, dict[str, float]] = field(default_factory=dict)
    texture: dict[str, Any] | None = None


def build_store(workplace: Workplace, name: str, heights: np.ndarray, cell_size: float) -> TerrainStore:
    """Open the store of heights (H, W) in meters, which is built if it does not exist yet."""
    store = workplace.folder / name
    if not store.exists():
        source = workplace.folder / f"{name}.tif"
        tifffile.imwrite(source, heights[::-1].astype(np.float32))
        build_from(workplace, source, store, cell_size)
    return TerrainStore(store)


def build_fractal(workplace: Workplace, terrain: FractalTerrain) -> TerrainStore:
    """Open the store of a fractal terrain, which is built if it does not exist yet. The terrain need not fit into memory."""
    store = workplace.folder / f"fractal-{terrain.size}"
    if not store.exists():
        build_from(workplace, write_fractal(workplace, terrain), store, CELL_SIZE)
    return TerrainStore(store)


def write_fractal(workplace: Workplace, terrain: FractalTerrain) -> Path:
    """Return the file of a fractal terrain, which is written if it does not exist yet."""
    path = workplace.folder / f"fractal-{terrain.size}.tif"
    if not path.exists():
        terrain.write(path)
    return path


def build_from(workplace: Workplace, source: Path, out: Path, cell_size: float) -> None:
    """Build a store in this process and the workers of the executor."""
    started, cpu = time.perf_counter(), cpu_seconds()
    terrain = open_field([source], FieldSettings(cell_size=cell_size))
    run_to_end(build_terrain(terrain, [source], out, BdamSettings(executor=workplace.executor, cell_size=cell_size)))
    workplace.costs[out.name] = {
        "seconds": round(time.perf_counter() - started, 2),
        "cpu_seconds": round(cpu_seconds() - cpu, 2),
        "samples": terrain.shape[0] * terrain.shape[1],
    }


def build_cut_mesh(cache: PatchCache, cut: Cut) -> CutMesh:
    """Return the mesh of a whole cut."""
    return merge_patches([cache.read(key) for key in cut.list_patches()], cut.levels)


def cpu_seconds() -> float:
    """Return the CPU seconds of this process and of its children that have ended."""
    return sum(os.times()[:4])


def store_bytes(folder: Path) -> int:
    """Return the bytes of all files in a folder and its subfolders."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
