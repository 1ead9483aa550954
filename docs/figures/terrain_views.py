"""Renders of terrain in nested boxes: two views, and frames of a walk along a path that is found through a cave."""

import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from lib import environment

environment.import_farfield()

import bpy
import numpy as np
from figures.voxel_tree import write_tree
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter1d, label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from farfield.addon.bridge.scatter import add_scatter
from farfield.addon.bridge.sky import add_sky
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.scatter import ScatterSettings
from farfield.addon.core.sky import SkySettings
from farfield.addon.operators.clipbox.job import prepare
from farfield.addon.operators.following import recenter
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.sky import add_haze
from lib.studio import look_at_matrix

TERRAIN = ClipboxSettings(terrain="cascades", seed=2, resolution=128, boxes=6, voxel_size=0.5)
SEARCH_GRID = Grid((-96, -96, -64), (192, 192, 112), 2.0)
CLEARANCE = 2.5  # voxels of the search grid between the walker and walls
LOOK_AHEAD = 14.0  # scene units
LIGHT_WATTS = 9000.0
SIDE_LIGHT = 1.95  # From the direction of a view to that of the Sun, clockwise, radians.
MAX_OUTSIDE = 2  # voxels of the search grid without a roof above


class WideView(NamedTuple):
    """A picture as wide as a page. position, target: (3,), scene units. scattered: the kind of plants and rocks, none if it is empty."""

    settings: ClipboxSettings
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    scattered: str = ""
    light: SkySettings | None = None


_SETTINGS = partial(ClipboxSettings, resolution=192, boxes=7, voxel_size=0.5)
WIDE_VIEWS = {
    "landscape": WideView(
        _SETTINGS(terrain="alps", scale=0.25, seed=5, boxes=8, voxel_size=1.0), (693.4, 458.1, -26.8), (643.2, 544.6, -28.0), "forest"
    ),
    "canyon": WideView(
        _SETTINGS(terrain="canyon", boxes=8), (-280.0, -140.0, 345.0), (-620.0, 20.0, 260.0), "rocks", SkySettings(light="morning")
    ),
    "lava": WideView(_SETTINGS(terrain="lava"), (136.0, -1482.0, 14.0), (-492.0, -1020.0, 62.0), "", SkySettings(light="golden_hour")),
    "karst": WideView(_SETTINGS(terrain="karst", voxel_size=0.75), (584.0, -645.0, 129.0), (487.0, -619.0, 107.0), "forest"),
    "desert": WideView(_SETTINGS(terrain="mesas", seed=2), (256.0, -208.0, -45.0), (420.0, 157.0, -35.0)),
    "coast": WideView(_SETTINGS(terrain="coast", water=True, voxel_size=0.75), (1050.0, -500.0, 30.0), (700.0, 0.0, 20.0), "meadow"),
    "woods": WideView(_SETTINGS(terrain="hills", seed=3, resolution=128), (300.0, 300.0, 26.6), (-200.0, 320.0, 11.6), "forest"),
    "steppe": WideView(_SETTINGS(terrain="mesas", seed=2, resolution=128), (256.0, -208.0, -63.2), (420.0, 157.0, -61.2), "steppe"),
}


def cave_path(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (frames, 3) of a walk through the longest cave near the origin, and points to look at (frames, 3), scene units."""
    air = build_sampler(TERRAIN).densities(SEARCH_GRID) <= 0
    is_covered = np.flip(np.cumsum(np.flip(~air, 2), axis=2), 2) > 0
    is_clear = distance_transform_edt(air) >= CLEARANCE
    is_covered = binary_dilation(is_covered & air, iterations=MAX_OUTSIDE)
    components, _ = label(is_clear & is_covered)
    cave = components == np.bincount(components.ravel())[1:].argmax() + 1
    indices = np.full(air.shape, -1)
    indices[cave] = np.arange(cave.sum())
    edges, lengths = [], []
    for offset in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0)):
        low = tuple(slice(max(-step, 0), count - max(step, 0)) for step, count in zip(offset, air.shape, strict=True))
        high = tuple(slice(max(step, 0), count - max(-step, 0)) for step, count in zip(offset, air.shape, strict=True))
        is_edge = (indices[low] >= 0) & (indices[high] >= 0)
        edges.append(np.stack([indices[low][is_edge], indices[high][is_edge]], axis=1))
        lengths.append(np.full(int(is_edge.sum()), np.linalg.norm(offset) * (2.0 if offset[2] else 1.0)))
    pairs, weights = np.concatenate(edges), np.concatenate(lengths)
    graph = coo_matrix((weights, (pairs[:, 0], pairs[:, 1])), shape=(int(cave.sum()),) * 2).tocsr()
    start = int(_farthest(dijkstra(graph, directed=False, indices=0)))
    distances, predecessors = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    node, path = int(_farthest(distances)), []
    while node >= 0:
        path.append(node)
        node = int(predecessors[node])
    positions = (np.argwhere(cave)[path] + SEARCH_GRID.origin + 0.5) * SEARCH_GRID.voxel_size
    positions = gaussian_filter1d(positions.astype(np.float64), 4.0, axis=0, mode="nearest")
    arc_lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    sampled = np.linspace(0.0, arc_lengths[-1] - LOOK_AHEAD, frames)
    return tuple(
        np.stack([np.interp(lengths, arc_lengths, positions[:, axis]) for axis in range(3)], axis=1)
        for lengths in (sampled, sampled + LOOK_AHEAD)
    )


def _farthest(distances: np.ndarray) -> int:
    return np.where(np.isfinite(distances), distances, -1.0).argmax()


def walk(frames: int, width: int, samples: int, folder: Path) -> list[Path]:
    """Render the frames of the walk; the terrain is recentered in every frame. Returns their paths."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    positions, targets = cave_path(frames)
    job = prepare(TERRAIN, positions[0])
    run_to_end(run_job(job))
    camera, point_light = _set_up_scene(width, samples)
    paths = []
    for frame, (position, target) in enumerate(zip(positions, targets, strict=True)):
        recenter(job.terrain, position)
        camera.matrix_world = look_at_matrix((position - target) / np.linalg.norm(position - target), position)
        point_light.location = position + [0.0, 0.0, 1.0]
        path = folder / f"walk-{frame:02}.png"
        bpy.context.scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        paths.append(path)
    return paths


def wide_view(name: str) -> Callable[[Path, int, int], None]:
    """Return the function that renders a view of `WIDE_VIEWS`, by the path of the picture, its width in pixels, and samples per pixel."""
    view = WIDE_VIEWS[name]

    def render(path: Path, width: int, samples: int) -> None:
        _render_view(path, width, samples, view.settings, np.array(view.position), np.array(view.target), None, view.scattered, view.light)

    return render


def copses(path: Path, width: int, samples: int) -> None:
    """Render one view of hills with voxel trees."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree.npy"
        write_tree(tree, seed=3)
        settings = ClipboxSettings(
            terrain="forest", source=str(tree), plant_size=40.0, forest_hills=30.0, resolution=192, boxes=7, voxel_size=0.5, seed=1
        )
        _render_view(path, width, samples, settings, np.array([0.0, 0.0, 80.0]), np.array([300.0, 160.0, 0.0]))


def square_view(
    path: Path,
    pixels: int,
    samples: int,
    settings: ClipboxSettings,
    position: np.ndarray,
    target: np.ndarray,
    light: SkySettings | None = None,
) -> None:
    """Render a square view of terrain from `position` (3,) towards `target` (3,), with the Sun of `light` at its side."""
    _render_view(path, pixels, samples, settings, position, target, height=pixels, light=light)


def _render_view(
    path: Path,
    width: int,
    samples: int,
    settings: ClipboxSettings,
    position: np.ndarray,
    target: np.ndarray,
    height: int | None = None,
    scattered: str = "",
    light: SkySettings | None = None,
) -> None:
    """Render terrain from `position` (3,) towards `target` (3,), in the format 16:9 unless a height in pixels is given.

    scattered: the kind of plants and rocks, none if it is empty.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    job = prepare(settings, position)
    run_to_end(run_job(job))
    camera, point_light = _set_up_scene(width, samples)
    point_light.data.energy = 0.0
    x, y, _ = target - position
    light = replace(light or SkySettings(), sun_direction=(math.atan2(x, y) + SIDE_LIGHT) % (2.0 * math.pi))
    add_sky(bpy.context.scene, light)
    add_haze(job.terrain, light)
    camera.matrix_world = look_at_matrix((position - target) / np.linalg.norm(position - target), position)
    if scattered:
        add_scatter(bpy.context.scene, job.terrain, ScatterSettings(kind=scattered), job.terrain.meter)
    bpy.context.scene.render.filepath = str(path)
    bpy.context.scene.render.resolution_y = height or bpy.context.scene.render.resolution_y
    bpy.ops.render.render(write_still=True)


def _set_up_scene(width: int, samples: int) -> tuple[bpy.types.Object, bpy.types.Object]:
    """Add a camera, a point light for caves, Sun and sky, and select Cycles. Returns the camera and the point light."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    point_light = bpy.data.objects.new("Point", bpy.data.lights.new("Point", "POINT"))
    for item in (camera, point_light):
        scene.collection.objects.link(item)
    scene.camera = camera
    add_sky(scene, SkySettings())
    camera.data.angle, camera.data.clip_start, camera.data.clip_end = 1.25, 0.1, 1e5
    point_light.data.energy, point_light.data.shadow_soft_size = LIGHT_WATTS, 0.5
    render = scene.render
    render.engine, render.use_persistent_data = "CYCLES", False
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, width * 9 // 16, 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = samples, True, 3
    scene.view_settings.view_transform = "AgX"
    return camera, point_light


VIEWS = {name: wide_view(name) for name in WIDE_VIEWS} | {"copses": copses}
