"""Views over terrain in nested boxes, and a walk through caves: a path is found by looking at voxels, and frames are rendered along it."""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

import environment

environment.import_farfield()

import bpy
import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter1d, label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from voxel_tree import write_tree

from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains import terrain_of
from farfield.addon.core.progress import finish
from farfield.addon.operators import clipbox_following, clipbox_job
from farfield.addon.operators.long_work import whole
from studio import looking_along, paint_sky, sun_matrix

TERRAIN = ClipboxSettings(terrain="cascades", seed=2, resolution=128, boxes=6, voxel=0.5)
SEARCHED = Grid((-96, -96, -64), (192, 192, 112), 2.0)
CLEARANCE = 2.5  # voxels of the search that the walker keeps from walls
AHEAD = 14.0  # scene units that the walker looks ahead
LAMP_WATTS = 9000.0
MOUTH = 2  # voxels of the search that the walker may be out in the open


def cave_path(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (frames, 3) of a walker through the longest cave near the origin, and what he looks at (frames, 3), in scene units."""
    air = terrain_of(TERRAIN).densities(SEARCHED) <= 0
    roofed = np.flip(np.cumsum(np.flip(~air, 2), axis=2), 2) > 0
    free = distance_transform_edt(air) >= CLEARANCE
    roofed = binary_dilation(roofed & air, iterations=MOUTH)
    parts, _ = label(free & roofed)
    cave = parts == np.bincount(parts.ravel())[1:].argmax() + 1
    numbers = np.full(air.shape, -1)
    numbers[cave] = np.arange(cave.sum())
    steps, lengths = [], []
    for offset in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0)):
        low = tuple(slice(max(-each, 0), side - max(each, 0)) for each, side in zip(offset, air.shape, strict=True))
        high = tuple(slice(max(each, 0), side - max(-each, 0)) for each, side in zip(offset, air.shape, strict=True))
        joined = (numbers[low] >= 0) & (numbers[high] >= 0)
        steps.append(np.stack([numbers[low][joined], numbers[high][joined]], axis=1))
        lengths.append(np.full(int(joined.sum()), np.linalg.norm(offset) * (2.0 if offset[2] else 1.0)))
    pairs, weights = np.concatenate(steps), np.concatenate(lengths)
    graph = coo_matrix((weights, (pairs[:, 0], pairs[:, 1])), shape=(int(cave.sum()),) * 2).tocsr()
    start = int(_farthest(dijkstra(graph, directed=False, indices=0)))
    distances, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    at, way = int(_farthest(distances)), []
    while at >= 0:
        way.append(at)
        at = int(before[at])
    places = (np.argwhere(cave)[way] + SEARCHED.origin + 0.5) * SEARCHED.voxel
    places = gaussian_filter1d(places.astype(np.float64), 4.0, axis=0, mode="nearest")
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    shown = np.linspace(0.0, along[-1] - AHEAD, frames)
    return tuple(np.stack([np.interp(where, along, places[:, axis]) for axis in range(3)], axis=1) for where in (shown, shown + AHEAD))


def _farthest(distances: np.ndarray) -> int:
    return np.where(np.isfinite(distances), distances, -1.0).argmax()


def walk(frames: int, width: int, samples: int, folder: Path) -> list[Path]:
    """Rendered frames of the walk; the terrain follows the walker from frame to frame."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    places, targets = cave_path(frames)
    job = clipbox_job.prepare(TERRAIN, places[0])
    finish(whole(job))
    camera, lamp = _set_up(width, samples)
    made = []
    for frame, (place, target) in enumerate(zip(places, targets, strict=True)):
        clipbox_following.follow_at_once(job.standing, place)
        camera.matrix_world = looking_along((place - target) / np.linalg.norm(place - target), place)
        lamp.location = place + [0.0, 0.0, 1.0]
        path = folder / f"walk-{frame:02}.png"
        bpy.context.scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        made.append(path)
    return made


def landscape(path: Path, width: int, samples: int) -> None:
    """One view over mountains."""
    settings = ClipboxSettings(terrain="cascades", resolution=192, boxes=7, voxel=0.5)
    _view(path, width, samples, settings, np.array([-40.0, -260.0, 75.0]), np.array([120.0, 120.0, -10.0]))


def copses(path: Path, width: int, samples: int) -> None:
    """One view over hills with trees of voxels."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree.npy"
        write_tree(tree, seed=3)
        settings = ClipboxSettings(
            terrain="forest", source=str(tree), source_size=40.0, forest_hills=30.0, resolution=192, boxes=7, voxel=0.5, seed=1
        )
        _view(path, width, samples, settings, np.array([0.0, 0.0, 80.0]), np.array([300.0, 160.0, 0.0]))


def _view(path: Path, width: int, samples: int, settings: ClipboxSettings, place: np.ndarray, target: np.ndarray) -> None:
    """A render of terrain from `place` (3,) towards `target` (3,)."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    finish(whole(clipbox_job.prepare(settings, place)))
    camera, lamp = _set_up(width, samples)
    lamp.data.energy = 0.0
    camera.matrix_world = looking_along((place - target) / np.linalg.norm(place - target), place)
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def _set_up(width: int, samples: int) -> tuple[bpy.types.Object, bpy.types.Object]:
    """A camera with a lamp beside it, the sun, and Cycles."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    for item in (camera, lamp, sun):
        scene.collection.objects.link(item)
    scene.camera, sun.matrix_world, sun.data.energy = camera, sun_matrix(), 4.0
    camera.data.angle, camera.data.clip_start, camera.data.clip_end = 1.25, 0.1, 1e5
    lamp.data.energy, lamp.data.shadow_soft_size = LAMP_WATTS, 0.5
    scene.world = bpy.data.worlds.new("Sky")
    paint_sky(scene.world)
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.46, 0.62, 0.85, 1.0)
    render = scene.render
    render.engine, render.use_persistent_data = "CYCLES", False
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, width * 9 // 16, 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = samples, True, 3
    scene.view_settings.view_transform = "Standard"
    return camera, lamp
