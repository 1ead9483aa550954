"""Benchmark of levels by distance: `python3 benchmarks/bench_distance.py [--model FILE] [--places N] [--report R.json]`.

Prints JSON: peak memory and seconds of one Cycles frame of a scatter, with full geometry and with levels by distance, each in a process of
its own; FLIP between both and between two renders of full geometry with other noise; seconds of the build. --sheets keeps the pictures.
"""

import json
import subprocess
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

from farfield.addon.bridge.distance.placing import clean_up, detach
from farfield.addon.bridge.geometry.mesh_arrays import read_positions
from farfield.addon.core.distance.settings import DistanceSettings
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.distance.job import describe_chain, prepare
from farfield.addon.operators.job_run import run_job
from lib import command_line, scene_files
from lib.contact_sheet import write_png
from lib.flip_metric import mean_flip

MODEL = environment.ROOT.parent / "shared" / "data" / "trees" / "leafy_tree.glb"
RENDER = """
import json, re, sys, time
from pathlib import Path
import bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
bpy.context.scene.cycles.seed = int(sys.argv[3])
bpy.context.scene.render.filepath = sys.argv[2]
started, cpu = time.perf_counter(), time.process_time()
bpy.ops.render.render(write_still=True)
seconds = {"seconds": round(time.perf_counter() - started, 2), "cpu_seconds": round(time.process_time() - cpu, 2)}
status = Path("/proc/self/status")  # Other counters include the memory of the process that started this one.
peak = int(re.search(r"VmHWM:\\s+(\\d+) kB", status.read_text())[1]) if status.exists() else None
print(json.dumps({**seconds, "peak_memory_mb": None if peak is None else round(peak * 1024e-6, 1)}))
bpy.ops.wm.read_factory_settings(use_empty=True)
"""


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the benchmark and return one JSON object."""
    parser = benchmark_cli.build_parser("bench_distance.py", __doc__, PARTS)
    parser.add_argument("--model", type=Path, default=MODEL, help="the model to scatter, as one object")
    parser.add_argument("--places", type=int, default=2000, help="number of instances")
    parser.add_argument("--samples", type=int, default=32, help="of the renders")
    parser.add_argument("--max-error", type=float, default=1.0, help="in pixels")
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
        job = prepare(scene, [scene.objects["Scatter"]], DistanceSettings(max_error=given.max_error))
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
    scene_files.open_scene(model.absolute())
    scene = bpy.context.scene
    parts = [item for item in scene.objects if item.type == "MESH"]
    for item in scene.objects:
        item.select_set(item in parts)
    bpy.context.view_layer.objects.active = parts[0]
    bpy.ops.object.parent_clear(type="CLEAR_KEEP_TRANSFORM")
    bpy.ops.object.transform_apply()
    if len(parts) > 1:
        bpy.ops.object.join()
    kind = bpy.context.view_layer.objects.active
    positions = read_positions(kind.data)
    low, high = positions.min(axis=0), positions.max(axis=0)
    scale = 5.0 / (high[2] - low[2])
    kind.data.vertices.foreach_set("co", ((positions - [*(0.5 * (low + high))[:2], low[2]]) * scale).astype(np.float32).ravel())
    for item in [item for item in scene.objects if item != kind]:
        bpy.data.objects.remove(item)
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


def add_scatter(kind: bpy.types.Object, points: np.ndarray) -> bpy.types.Object:
    """Return a new object whose geometry nodes instance `kind` at `points`, turned at random."""
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata(points, [], [])
    item = bpy.data.objects.new("Scatter", mesh)
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    names = ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeInstanceOnPoints", "GeometryNodeObjectInfo", "FunctionNodeRandomValue")
    given, result, on_points, source, turns = (tree.nodes.new(name) for name in names)
    source.inputs["Object"].default_value, source.inputs["As Instance"].default_value = kind, True
    turns.data_type = "FLOAT_VECTOR"
    turns.inputs["Min"].default_value, turns.inputs["Max"].default_value = (0.0, 0.0, 0.0), (0.0, 0.0, 2.0 * np.pi)
    tree.links.new(given.outputs[0], on_points.inputs["Points"])
    tree.links.new(source.outputs["Geometry"], on_points.inputs["Instance"])
    tree.links.new(turns.outputs[0], on_points.inputs["Rotation"])
    tree.links.new(on_points.outputs[0], result.inputs[0])
    item.modifiers.new("Scatter", "NODES").node_group = tree
    return item


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


def render(scene: Path, image: Path, seed: int) -> dict[str, float]:
    """Render a frame in a new process. Returns its seconds and its peak memory."""
    command = [sys.executable, "-c", RENDER, str(scene), str(image), str(seed)]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return json.loads(next(line for line in reversed(output.splitlines()) if line.startswith("{")))


def read_image(path: Path) -> np.ndarray:
    """Return the pixels (H, W, 3) of a PNG file, sRGB values in 0..1, row 0 at the bottom."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.zeros(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, -1)[..., :3].copy()


PARTS = {"scatter": measure_scatter}


if __name__ == "__main__":
    command_line.run(main)
