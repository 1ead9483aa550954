"""Benchmark of levels by distance: `python3 benchmarks/bench_distance.py [--only scatter valley] [--report R.json]`.

Prints JSON. Part "scatter": peak memory and seconds of one Cycles frame of a scatter, with full geometry and with levels by distance, each
in a process of its own; FLIP between both and between two renders of full geometry with other noise; seconds of the build. Part "valley":
the same for a flight through a valley of heavy assets, and for levels by Decimate. --sheets keeps the pictures; frames of the flight that
are there are not rendered again.
"""

import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import bpy
import numpy as np
from distance_flight import measure_flight
from distance_renders import read_image, render
from distance_valley import FRAMES, HOUSES, PROPS, ROCKS, ValleyOptions, add_scatter, import_model

from farfield.addon.bridge.distance.placing import clean_up, detach
from farfield.addon.core.distance.settings import DistanceSettings
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.distance.job import describe_chain, prepare
from farfield.addon.operators.job_run import run_job
from lib import command_line
from lib.contact_sheet import write_png
from lib.flip_metric import mean_flip

MODEL = environment.ROOT.parent / "shared" / "data" / "trees" / "leafy_tree.glb"


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the benchmark and return one JSON object."""
    parser = benchmark_cli.build_parser("bench_distance.py", __doc__, PARTS)
    parser.add_argument("--model", type=Path, default=MODEL, help="the model to scatter, as one object")
    parser.add_argument("--places", type=int, default=2000, help="number of instances")
    parser.add_argument("--samples", type=int, default=32, help="of the renders")
    parser.add_argument("--max-error", type=float, default=1.0, help="in pixels")
    parser.add_argument("--fade-range", type=float, default=DistanceSettings().fade_range, help="of levels, relative to distances")
    parser.add_argument("--seed", type=int, default=0, help="of everything random in the valley")
    parser.add_argument("--trees", type=int, default=10_000, help="number of trees in the valley")
    parser.add_argument("--rocks", type=int, default=ROCKS, help="number of rocks in the valley")
    parser.add_argument("--houses", type=int, default=HOUSES, help="number of houses in the valley")
    parser.add_argument("--props", type=int, default=len(PROPS), help="number of files whose models stand in the valley")
    parser.add_argument("--frames", type=int, nargs="+", default=list(range(1, FRAMES + 1)), help="of the flight that are rendered")
    parser.add_argument("--width", type=int, default=960, help="of the images of the flight, in pixels")
    parser.add_argument("--sheets", type=Path, help="a folder for the pictures and the scenes")
    return benchmark_cli.run_parts(parser.parse_args(arguments), PARTS)


def measure_scatter(given: Namespace) -> dict[str, Any]:
    """Measure one frame with full geometry, with levels by distance, and FLIP between them."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if given.sheets is None else given.sheets.absolute()
        folder.mkdir(parents=True, exist_ok=True)
        build_scene(given.model, given.places, given.samples)
        started = time.perf_counter()
        scene = bpy.context.scene
        job = prepare(scene, [scene.objects["Scatter"]], DistanceSettings(max_error=given.max_error, fade_range=given.fade_range))
        message = run_to_end(run_job(job))
        seconds = round(time.perf_counter() - started, 1)
        bounces = scene.cycles.transparent_max_bounces  # Full geometry gets as many, or its stacked leaves would be black and cheaper.
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "levels.blend"))
        detach([scene.objects["Scatter"]])
        clean_up(scene)
        scene.cycles.transparent_max_bounces = bounces
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "full.blend"))
        figures = {name: render(folder / f"{name}.blend", folder / f"{name}.png", 0) for name in ("full", "levels")}
        render(folder / "full.blend", folder / "noise.png", 1)
        images = {name: read_image(folder / f"{name}.png") for name in ("full", "levels", "noise")}
        flips = mean_flip([(images["full"], images["levels"]), (images["full"], images["noise"])])
        write_png(folder / "sheet.png", np.concatenate([images["full"], images["levels"]], axis=1))
    ratios = {f"{key}_ratio": round(figures["levels"][key] / value, 3) for key, value in figures["full"].items() if value}
    flip, noise = (None, None) if flips is None else (round(value, 4) for value in flips)
    chains = [describe_chain(*item) for item in job.chains]
    return {
        **figures,
        **ratios,
        "flip": flip,
        "flip_of_noise": noise,
        "build_seconds": seconds,
        "bounces": bounces,
        "message": message,
        "chains": chains,
    }


def build_scene(model: Path, places: int, samples: int) -> None:
    """Build a plane with instances of a model, scaled to a height of 5, up to a distance of 400 from a camera at a height of 14."""
    kind = import_model(model.absolute(), 5.0)
    scene = bpy.context.scene
    scene.collection.objects.link(add_scatter(kind, scatter_points(places)))
    for collection in kind.users_collection:
        collection.objects.unlink(kind)
    add_surroundings(scene, samples)


def scatter_points(places: int) -> np.ndarray:
    """Return positions (N, 3) in the view of the camera, uniform on the ground between the distances 20 and 400."""
    random = np.random.default_rng(0)
    distances = np.sqrt(random.uniform(20.0**2, 400.0**2, places))
    angles = random.uniform(-0.5, 0.5, places)
    return np.column_stack([distances * np.sin(angles), distances * np.cos(angles), 0.0 * distances])


def add_surroundings(scene: bpy.types.Scene, samples: int) -> None:
    """Add ground, sky, Sun and camera, and set up renders."""
    bpy.ops.mesh.primitive_plane_add(size=2000.0)
    ground = bpy.data.materials.new("Ground")
    ground.use_nodes = True
    ground.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.12, 0.1, 0.06, 1.0)
    bpy.context.object.data.materials.append(ground)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 4.0, (0.9, 0.0, 0.7)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.rotation_euler, camera.data.clip_end = (0.0, 0.0, 14.0), (0.46 * np.pi, 0.0, 0.0), 2000.0
    for item in (sun, camera):
        scene.collection.objects.link(item)
    scene.camera, scene.world = camera, bpy.data.worlds.new("Sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.35, 0.5, 0.8, 1.0)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", samples, False
    scene.render.resolution_x, scene.render.resolution_y = 800, 450
    scene.view_settings.view_transform = "Standard"


def measure_valley(given: Namespace) -> dict[str, Any]:
    """Measure a flight through a valley of heavy assets."""
    options = ValleyOptions(given.seed, given.trees, given.rocks, given.houses, given.props, given.width, given.samples)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if given.sheets is None else given.sheets.absolute() / "valley"
        return measure_flight(options, DistanceSettings(max_error=given.max_error, fade_range=given.fade_range), given.frames, folder)


PARTS = {"scatter": measure_scatter, "valley": measure_valley}


if __name__ == "__main__":
    command_line.run(main)
