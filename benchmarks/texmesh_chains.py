"""Textured models with their images, and levels of them with default settings, each made once for all parts of `bench_texmesh.py`."""

import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import texmesh_models
from texmesh_models import read_images

from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.imaging.mipmaps import Mipmaps, build_mipmaps, resize_by_area
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_chain import LevelChain, make_levels
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh
from lib import command_line

PAINTED_SIDE = 512  # pixels of generated textures
BUNNY = "bunny"
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class TexturedModel:
    """A mesh and an image (H, W, 3) float32 per material, linear; None for materials without one."""

    mesh: TexturedMesh
    textures: tuple[np.ndarray | None, ...]

    @property
    def mipmaps(self) -> list[Mipmaps | None]:
        """The mipmaps of all textures."""
        return [None if texture is None else build_mipmaps(texture) for texture in self.textures]


def default_settings() -> TexmeshSettings:
    """Return the default settings."""
    return TexmeshSettings()


def model_names(given: Namespace) -> list[str]:
    """Return the models that were asked for, or all, generated ones by the seed."""
    generated = [f"{kind}:{given.seed + index}" for index, kind in enumerate(texmesh_models.GENERATORS)]
    return given.models or [*texmesh_models.REAL_MODELS, BUNNY, *generated]


@cache
def open_textured(data: Path, name: str, seed: int) -> TexturedModel:
    """Return a model with its own images, or with images painted by `seed` if it has none."""
    mesh = texmesh_models.open_model(data, name)
    if name in texmesh_models.REAL_MODELS:
        return TexturedModel(mesh, tuple(None if image is None else LINEAR_OF_BYTE[image] for image in read_images(data, name, mesh)))
    generator = np.random.default_rng(seed)
    return TexturedModel(mesh, tuple(paint(PAINTED_SIDE, generator) for _ in range(int(mesh.materials.max()) + 1)))


@cache
def make_chain(data: Path, name: str, seed: int) -> LevelChain:
    """Return the levels of a model with default settings."""
    model = open_textured(data, name, seed)
    return run_to_end(make_levels(model.mesh, model.textures, default_settings()))


def paint(side: int, generator: np.random.Generator) -> np.ndarray:
    """Return an image (side, side, 3) of soft spots of several sizes in two colors, linear."""
    total = np.zeros((side, side), np.float32)
    for cells in (8, 32, 128):
        coarse = generator.random((cells, cells, 1)).astype(np.float32)
        total += resize_by_area(np.repeat(np.repeat(coarse, side // cells, axis=0), side // cells, axis=1), side)[..., 0] / 3.0
    colors = generator.uniform(0.05, 0.9, (2, 3)).astype(np.float32)
    weights = np.clip(3.0 * total - 1.0, 0.0, 1.0)[..., None]
    return colors[0] + weights * (colors[1] - colors[0])


def measure_cost(run: Callable[[], Result], max_seconds: float, max_memory_mb: float) -> tuple[Result, dict[str, Any]]:
    """Return the result of `run`, and its seconds, CPU seconds of all threads and peak memory, with their bounds. The memory is that of
    the process."""
    before = command_line.peak_memory_mb()
    started, cpu_started = time.perf_counter(), time.process_time()
    result = run()
    return result, {
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(time.process_time() - cpu_started, 1),
        "max_seconds": max_seconds,
        "peak_memory_mb": round(command_line.peak_memory_mb()),
        "peak_memory_before_mb": round(before),
        "max_memory_mb": max_memory_mb,
    }
