"""A terrain with cliffs as a triangulated irregular network of Farfield, and as a mesh of right triangles with as many triangles, as in
Figure 12 of the BDAM paper."""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from lib import environment

environment.import_farfield()

import bpy
import numpy as np
from scipy.ndimage import gaussian_filter

from farfield.addon.bridge.geometry.mesh_pool import fill_mesh
from farfield.addon.core.bdam.building.height_grid import HeightGrid, encode_heights
from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.building.vertical_errors import measure_triangles
from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, open_field
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.tree import Tree
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.cut_meshes import CutMesh, merge_patches
from farfield.addon.core.bdam.view.extraction import extract_uniform_cut
from farfield.addon.core.jobs.progress import run_to_end
from lib.demo_terrain import fractal_heights

SIZE = 257
HEIGHT_STEP = 0.05  # meters
CELL_SIZE = 10.0  # meters
CLIFF_HEIGHT = 160.0  # meters
ERROR = 22.0  # meters, of the network


@dataclass(frozen=True)
class TerrainMesh:
    """A mesh of a terrain. error: the largest vertical distance to the terrain in meters."""

    item: bpy.types.Object
    triangles: int
    error: float


def create_cliffs() -> np.ndarray:
    """Return heights (SIZE, SIZE) in meters: hills with winding cliffs."""
    hills = fractal_heights(SIZE, seed=5) * 0.35
    plateaus = gaussian_filter(np.random.default_rng(2).standard_normal((SIZE, SIZE)), 28.0)
    return np.round((hills + CLIFF_HEIGHT * (plateaus > 0.0) + 0.5 * CLIFF_HEIGHT * (plateaus > 0.01)) / HEIGHT_STEP) * HEIGHT_STEP


def compare_meshes() -> list[TerrainMesh]:
    """Create objects in a new scene: the full grid, the network, and right triangles, all with flat shading."""
    heights = create_cliffs()
    steps = np.rint(heights / HEIGHT_STEP).astype(np.int32)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with tempfile.TemporaryDirectory() as folder:
        grid = HeightGrid(Path(folder) / "heights.raw", SIZE, SIZE)
        encode_heights(steps, np.ones(steps.shape, bool)).tofile(grid.path)
        source, out = Path(folder) / "heights.npy", Path(folder) / "terrain"
        np.save(source, heights[::-1])
        settings = BdamSettings(cell_size=CELL_SIZE, height_step=HEIGHT_STEP, executor="serial")
        run_to_end(build_terrain(open_field([source], FieldSettings(cell_size=CELL_SIZE)), [source], out, settings))
        with TerrainStore(out) as store:
            full, network = (_build_cut_mesh(store, error) for error in (0.0, ERROR))
        meshes = [(mesh.ids, mesh.triangles) for mesh in (full, network)]
        meshes.append(triangulate_right(steps, len(network.triangles)))
        return [_create_object(ids, triangles, steps, grid) for ids, triangles in meshes]


def _build_cut_mesh(store: TerrainStore, error: float) -> CutMesh:
    cut, cache = extract_uniform_cut(store, error), PatchCache(store)
    return merge_patches([cache.read(key) for key in cut.list_patches()], cut.levels)


def triangulate_right(steps: np.ndarray, triangle_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the consistent mesh of right triangles with about `triangle_count` triangles and the least error of midpoints: numbers of its
    samples (row * columns + column) and triangles (T, 3)."""
    tree = Tree(*steps.shape, leaf_cells=2)
    levels = [tree.triangle_corners(level, np.arange(2 << level)) for level in range(tree.leaf_level + 1)]
    errors = []
    for level in range(tree.leaf_level, -1, -1):
        start, end = levels[level][:, 0], levels[level][:, 1]
        midpoints = (start + end) // 2
        own = np.abs(0.5 * (steps[start[:, 1], start[:, 0]] + steps[end[:, 1], end[:, 0]]) - steps[midpoints[:, 1], midpoints[:, 0]])
        if errors:
            own = np.maximum(own, errors[-1].reshape(-1, 2).max(axis=1))
        first, second = (diamonds := tree.find_diamonds(level, np.arange(2 << level)))[diamonds[:, 1] >= 0].T
        own[first] = own[second] = np.maximum(own[first], own[second])
        errors.append(own)
    errors.reverse()
    low, high = 0.0, float(errors[0].max())
    for _ in range(40):
        limit = 0.5 * (low + high)
        corners = _cut(levels, errors, limit)
        low, high = (limit, high) if len(corners) > triangle_count else (low, limit)
    return np.arange(steps.size), corners[..., 1] * steps.shape[1] + corners[..., 0]


def _cut(levels: list[np.ndarray], errors: list[np.ndarray], limit: float) -> np.ndarray:
    """Return the corners (T, 3, 2) of the coarsest triangles whose errors are at most `limit`; the finest are not divided."""
    active, kept = np.arange(2), []
    for level, corners in enumerate(levels):
        is_divided = (errors[level][active] > limit) if level + 1 < len(levels) else np.zeros(len(active), bool)
        kept.append(corners[active[~is_divided]])
        active = (2 * active[is_divided][:, None] + np.arange(2)).ravel()
    return np.concatenate(kept)


def _create_object(ids: np.ndarray, triangles: np.ndarray, steps: np.ndarray, grid: HeightGrid) -> TerrainMesh:
    corners = ids[triangles]
    positions = np.stack([corners % SIZE, corners // SIZE], axis=-1)
    measured = measure_triangles(positions, steps.reshape(-1)[corners], grid)
    used, indices = np.unique(corners, return_inverse=True)
    vertices = np.stack([CELL_SIZE * (used % SIZE), CELL_SIZE * (used // SIZE), HEIGHT_STEP * steps.reshape(-1)[used]], axis=1)
    mesh = bpy.data.meshes.new("Terrain")
    fill_mesh(mesh, vertices, indices.reshape(-1, 3).astype(np.int32))
    item = bpy.data.objects.new("Terrain", mesh)
    bpy.context.scene.collection.objects.link(item)
    return TerrainMesh(item, len(triangles), HEIGHT_STEP * float(measured.errors.max()))
