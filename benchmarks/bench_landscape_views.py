"""Views of the presets of terrain from random cameras: `python3 benchmarks/bench_landscape_views.py --images FOLDER [flags]`.

Prints JSON: for each view the kind of place, the camera, the rays that see a face from behind, as through a crack, and the seconds of
its render. Kinds are taken in turn: near the ground, a valley, a summit, a cave, the air. The folder gets the renders, in Cycles, which
are there to be looked at, and with `--scenes` the scenes, for other engines. `--elevation-model FOLDER` adds views of a store of Large
Terrain with the same material. Each run draws other cameras; --seed repeats one.
"""

import copy
import math
import secrets
import sys
import time
from argparse import ArgumentDefaultsHelpFormatter, Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import json

import bpy
import mathutils
import numpy as np

from farfield.addon.bridge.bdam.objects import SceneTerrain as RealTerrain
from farfield.addon.bridge.bdam.objects import remove
from farfield.addon.bridge.scatter import add_scatter
from farfield.addon.bridge.sky import add_sky
from farfield.addon.bridge.terrain_roots import TerrainRoot
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import Sampler, build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.presets import read_preset
from farfield.addon.core.scatter import ScatterSettings
from farfield.addon.core.sky import SkySettings
from farfield.addon.operators.clipbox.job import prepare
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.sky import add_haze
from lib import command_line
from lib.studio import look_at_matrix

PRESETS = Path(__file__).resolve().parents[1] / "addon" / "presets" / "clipbox"
# The presets, and what is scattered on their ground.
SCATTERED = {
    "Alpine Range": "forest", "Rolling Hills": "meadow", "Canyon": "rocks", "Mesas": "steppe", "Coast": "meadow", "Dunes": "",
    "Karst Bay": "forest",
    "Arches": "steppe", "Alien": "rocks", "Lava": "", "Caves and Arches": "rocks", "Elevation Model": "forest",
}  # fmt: skip
REAL = "Elevation Model"
KINDS = ("near the ground", "valley", "summit", "cave", "air")
REAL_REACH = 10_000.0  # Meters around the center of an elevation model.
REACH, CANDIDATES = 700.0, 24  # Scene units around the origin, and random places of which valleys are the lowest and summits the highest.
EYE = {"near the ground": 1.7, "valley": 2.5, "summit": 4.0, "cave": 1.7, "air": 130.0}  # Meters above the ground.
FREE = 10.0  # Meters that the camera sees at least.
PITCH = {"near the ground": -0.02, "valley": 0.06, "summit": -0.12, "cave": 0.02, "air": -0.3}  # Radians.
CAVE_GRID, CAVE_VOXEL = (96, 96, 64), 3.0
ANGLE, RAYS = 1.15, (64, 36)  # Width of the view, radians; rays that look for cracks.


class View(NamedTuple):
    """A camera. kind: one of KINDS. position, direction: (3,) scene units. backsides: rays that see a face from behind."""

    kind: str
    position: np.ndarray
    direction: np.ndarray
    backsides: int


def choose_view(kind: str, settings: ClipboxSettings, random: np.random.Generator) -> tuple[Any, View] | None:
    """Build the terrain around a random place of a kind and return it with a camera there; None if there is no such place nearby."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    sampler = build_sampler(settings)
    position = find_place(kind, settings, sampler, random)
    if position is None:
        return None
    job = prepare(settings, position)
    run_to_end(run_job(job))
    bpy.context.view_layer.update()
    if kind != "cave":
        ground = cast(np.array([*position[:2], position[2] + 500.0 * settings.scale]), np.array([0.0, 0.0, -1.0]))
        if ground is None:
            return None
        position = ground[0] + [0.0, 0.0, EYE[kind] * settings.scale]
    return job.terrain, look_around(kind, position, random, settings.scale)


def look_around(kind: str, position: np.ndarray, random: np.random.Generator, scale: float) -> View:
    """Return a view from a position (3,) into the first of some random directions in which nothing is right before the camera."""
    for azimuth in random.permutation(np.arange(12)) * math.pi / 6.0 + random.uniform(0.0, 0.5):
        direction = np.array([math.cos(azimuth) * math.cos(PITCH[kind]), math.sin(azimuth) * math.cos(PITCH[kind]), math.sin(PITCH[kind])])
        hits = [cast(position, ray) for ray in rays_of(direction, (9, 5))]
        distances = [np.linalg.norm(hit[0] - position) if hit is not None else np.inf for hit in hits]
        if np.percentile(distances, 20) > FREE * scale:
            break
    view = View(kind, position, direction, 0)
    return view._replace(backsides=count_backsides(view))


def count_backsides(view: View) -> int:
    """Return how many of the rays of a view see a face from behind."""
    hits = [cast(view.position, ray) for ray in rays_of(view.direction, RAYS)]
    return sum(hit is not None and hit[1] for hit in hits)


def choose_real_view(store: Path, kind: str, random: np.random.Generator) -> tuple[Any, View] | None:
    """Load a store of Large Terrain for a camera at a random place of a kind; see `choose_view`.

    Elevation models have no caves. Returns None where one has no data.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    camera = add_camera()
    camera.location = 0.0, 0.0, 2e4
    load(store)
    places = random.uniform(-REAL_REACH, REAL_REACH, (CANDIDATES, 2))
    hits = [cast(np.array([*place, 1e5]), np.array([0.0, 0.0, -1.0])) for place in places]
    heights = np.array([hit[0][2] if hit is not None else np.nan for hit in hits])
    index = {"valley": np.nanargmin, "summit": np.nanargmax}.get(kind, lambda values: np.isfinite(values).argmax())(heights)
    view = View(kind, np.array([*places[index], heights[index] + EYE[kind]]), np.array([1.0, 0.0, 0.0]), 0)
    for _ in range(2):  # What is outside of the view is coarse.
        camera.matrix_world = look_at_matrix(-view.direction, view.position)
        terrain = load(store)
        ground = cast(np.array([*places[index], 1e5]), np.array([0.0, 0.0, -1.0]))
        if ground is None:
            return None
        view = look_around(kind, ground[0] + [0.0, 0.0, EYE[kind]], copy.deepcopy(random), 1.0)
    camera.matrix_world = look_at_matrix(-view.direction, view.position)
    terrain = load(store)
    return terrain, view._replace(backsides=count_backsides(view))


def load(store: Path) -> TerrainRoot:
    """Show a store of Large Terrain for the active camera, in place of one that is shown."""
    for terrain in RealTerrain.in_scene(bpy.context.scene):
        remove(terrain)
    bpy.context.view_layer.update()
    bpy.ops.farfield.bdam_load("EXEC_DEFAULT", directory=str(store), use_relative_path=False)
    bpy.context.view_layer.update()
    return RealTerrain.in_scene(bpy.context.scene)[0]


def find_place(kind: str, settings: ClipboxSettings, sampler: Sampler, random: np.random.Generator) -> np.ndarray | None:
    """Return the position (3,) of the eye in a cave, otherwise one on or near the ground; None if there is no cave."""
    places = random.uniform(-REACH, REACH, (CANDIDATES, 2))
    if kind == "cave":
        for place in places[:8]:
            floor = find_cave(sampler, np.array([*place, find_height(sampler, place, settings)]), random)
            if floor is not None and not (settings.water and floor[2] < settings.water_level):
                return floor + [0.0, 0.0, EYE[kind] * settings.scale]
        return None
    heights = np.array([find_height(sampler, place, settings) for place in places])
    if settings.water:
        heights = np.where(heights < settings.water_level + 1.0, np.inf if kind == "valley" else -np.inf, heights)
    index = {"valley": heights.argmin(), "summit": heights.argmax()}.get(kind, np.isfinite(heights).argmax())
    return np.array([*places[index], heights[index]])


def find_height(sampler: Sampler, place: np.ndarray, settings: ClipboxSettings) -> float:
    """Return the height of the topmost ground at a place (2,), within about 4 voxels."""
    step = 4.0 * settings.voxel_size
    x, y = np.floor(place / step).astype(int).tolist()
    low = -int(600.0 * settings.scale / step) - 64
    solid = sampler.signs(Grid((x, y, low), (1, 1, -2 * low), step), repair=False)[0, 0] > 0
    above = np.flatnonzero(solid)
    return float((low + above[-1] + 1) * step) if len(above) else 0.0


def find_cave(sampler: Sampler, near: np.ndarray, random: np.random.Generator) -> np.ndarray | None:
    """Return a random place (3,) on the floor of a cave near a place (3,): air with a roof, at least 4 m high and 20 m wide."""
    origin = np.floor(near / CAVE_VOXEL).astype(int) - [48, 48, 44]
    air = sampler.densities(Grid(tuple(origin.tolist()), CAVE_GRID, CAVE_VOXEL)) <= 0
    has_roof = np.flip(np.cumsum(np.flip(~air, 2), axis=2), 2) > 0
    is_floor = air & has_roof
    is_floor[:, :, 1:] &= ~air[:, :, :-1]
    is_floor[:, :, 0] = False
    is_floor[:, :, :-2] &= air[:, :, 1:-1] & air[:, :, 2:]
    for axis in (0, 1):
        for shift in (-3, 3):
            is_floor &= np.roll(air, shift, axis)
    found = np.argwhere(is_floor[4:-4, 4:-4]) + [4, 4, 0]
    return (origin + found[random.integers(len(found))] + [0.5, 0.5, 0.0]) * CAVE_VOXEL if len(found) else None


def add_camera() -> bpy.types.Object:
    """Return a new active camera."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    camera.data.angle, camera.data.clip_start, camera.data.clip_end = ANGLE, 0.05, 1e6
    return camera


def cast(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, bool] | None:
    """Return where a ray first meets the scene, and whether it meets a face from behind; None if it meets nothing."""
    graph = bpy.context.evaluated_depsgraph_get()
    is_hit, location, normal, _, item, _ = bpy.context.scene.ray_cast(graph, mathutils.Vector(origin), mathutils.Vector(direction))
    return (np.array(location), normal.dot(mathutils.Vector(direction)) > 0.0 and "Water" not in item.name) if is_hit else None


def rays_of(direction: np.ndarray, counts: tuple[int, int]) -> np.ndarray:
    """Return directions (N, 3) of rays through the image of a camera."""
    right = np.cross(direction, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    half = math.tan(0.5 * ANGLE)
    x, y = np.meshgrid(np.linspace(-half, half, counts[0]), np.linspace(-half, half, counts[1]) * 9.0 / 16.0)
    rays = direction + x.reshape(-1, 1) * right + y.reshape(-1, 1) * np.cross(right, direction)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def render(
    path: Path, view: View, width: int, samples: int, save: bool, light: SkySettings, prepare_ground: Callable[[SkySettings], None]
) -> float:
    """Render a view with the Sun at its side, and save its scene next to the picture if `save` is set. Returns seconds.

    prepare_ground: adds what depends on the camera and on the sky.
    """
    scene = bpy.context.scene
    camera = scene.camera or add_camera()
    camera.matrix_world = look_at_matrix(-view.direction, view.position)
    sky = replace(light, sun_direction=(math.atan2(view.direction[0], view.direction[1]) + 1.9) % (2.0 * math.pi))
    add_sky(scene, sky)
    prepare_ground(sky)
    if view.kind == "cave":
        light = bpy.data.objects.new("Light", bpy.data.lights.new("Light", "POINT"))
        light.data.energy, light.location = 3000.0, view.position + [0.0, 0.0, 1.0]
        scene.collection.objects.link(light)
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.filepath = width, width * 9 // 16, str(path)
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = samples, True, 6
    scene.view_settings.view_transform = "AgX"
    started = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    if save:
        bpy.ops.wm.save_as_mainfile(filepath=str(path.with_suffix(".blend")), compress=True)
    return time.perf_counter() - started


def show_views(name: str, choose: Callable[[str, np.random.Generator], Any], light: SkySettings, given: Namespace) -> list[dict[str, Any]]:
    """Choose the views of a terrain, and render them if a folder is given. Returns their measurements."""
    random, figures = np.random.default_rng([given.seed, list(SCATTERED).index(name)]), []
    for index in range(given.count):
        found = choose(KINDS[index % len(KINDS)], random) or choose(KINDS[0], random)
        if found is None:
            continue
        terrain, view = found
        figure = {"kind": view.kind, "position": view.position.round(1).tolist(), "direction": view.direction.round(3).tolist()}
        figure["rays_from_behind"] = view.backsides
        if given.images is not None:

            def prepare_ground(sky: SkySettings, terrain: Any = terrain) -> None:
                add_haze(terrain, sky)
                if SCATTERED[name]:
                    add_scatter(bpy.context.scene, terrain, ScatterSettings(kind=SCATTERED[name]), terrain.meter)

            given.images.mkdir(parents=True, exist_ok=True)
            path = given.images / f"{name} {index + 1:02} {view.kind}.png"
            figure["seconds"] = round(render(path, view, given.width, given.samples, given.scenes, light, prepare_ground), 1)
        figures.append(figure)
        print(f"{name}: {json.dumps(figure)}", file=sys.stderr, flush=True)
    return figures


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Render the views; returns the measurements as JSON."""
    parser = command_line.Parser(
        prog="bench_landscape_views.py", description=__doc__.split("\n")[0], formatter_class=ArgumentDefaultsHelpFormatter
    )
    presets = [name for name in SCATTERED if name != REAL]
    parser.add_argument("--presets", nargs="*", choices=presets, default=presets, help="presets to show")
    parser.add_argument("--elevation-model", type=Path, help="a store of Large Terrain to show as well")
    parser.add_argument("--count", type=int, default=12, help="cameras of each preset")
    parser.add_argument("--images", type=Path, help="folder for the renders; without it, only rays are cast")
    parser.add_argument("--scenes", action="store_true", help="save the scene of each render next to it")
    parser.add_argument("--width", type=int, default=1280, help="pixels of the renders")
    parser.add_argument("--samples", type=int, default=24, help="samples per pixel")
    parser.add_argument("--resolution", type=int, default=128, help="voxels along each side of every box")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(1_000_000), help="of the cameras")
    given = parser.parse_args(arguments)
    figures: dict[str, Any] = {"seed": given.seed}
    for preset in given.presets:
        found = read_preset(PRESETS / f"{preset}.json", [ClipboxSettings, SkySettings])
        settings = replace(found.build(ClipboxSettings), resolution=given.resolution)
        light = found.build(SkySettings)
        figures[preset] = show_views(preset, lambda kind, random, settings=settings: choose_view(kind, settings, random), light, given)
    if given.elevation_model is not None:
        store = given.elevation_model.resolve()
        figures[REAL] = show_views(REAL, lambda kind, random: choose_real_view(store, kind, random), SkySettings(), given)
    return json.dumps(figures, indent=1)


if __name__ == "__main__":
    command_line.run(main)
