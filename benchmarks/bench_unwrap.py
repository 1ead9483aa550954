"""Compares UV maps of Farfield, of Blender's three methods and of xatlas in one process: `python3 benchmarks/bench_unwrap.py [flags]`.

Prints JSON. Parts (`--only`): `stretch` (metrics and time of all meshes; other methods where a mesh is a disk), `quality_limit` (cost of a
minimum triangle quality), `importance` (density ratio, and stretch of the important part), `cracks` (maximum stretch of the bunny with and
without the limit), `growth` (time by number of triangles), `million` (time, memory, and the longest time between two progress reports).
"""

import json
import sys
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import bpy
import numpy as np

from farfield.addon.bridge.geometry.mesh_arrays import read_uvs
from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap import importance
from farfield.addon.core.unwrap.distortion import DistortionMetrics, compute_stretches, measure_distortion
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import UnwrapResult, unwrap
from lib import command_line, scene_files

MAX_EXCESS_OVER_BLENDER = {
    "optcuts_face": 0.70,
    "bff_cowhead": 0.70,
    "bff_face": 0.85,
    "sceaux_15k": 0.85,
}  # L2 - 1, of meshes that are disks
FILES = {
    **{name: f"meshes/{name}.obj" for name in ("optcuts_face", "bff_cowhead", "bff_face", "max_planck", "stanford_bunny")},
    "sceaux_15k": "sceaux/mesh_15k.ply",
    "sceaux_175k": "sceaux/mesh_175k.ply",
    "spot": "textured/spot/spot.obj",
    "blub": "textured/blub/blub.glb",
    "leafy_tree": "trees/leafy_tree.glb",
    "tree": "trees/tree.glb",
    "pine_tree": "trees/pine_tree.glb",
}
HEAD_DIRECTIONS = {"max_planck": (0.0, 0.0, 1.0), "bff_face": (0.0, -0.36, 0.93), "optcuts_face": (0.0, -1.0, 0.0)}
BLENDER_METHODS = ("ANGLE_BASED", "CONFORMAL", "MINIMUM_STRETCH")
STRETCH_ONLY = {"min_quality": 0.0, "further_cuts": False}
QUALITY_LIMITS = (0.05, 0.1, 0.15)
DOME_SIZES = 10_000, 30_000, 100_000, 300_000


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_unwrap.py", __doc__, PARTS)
    parser.add_argument("--models", nargs="+", choices=list(FILES), default=list(FILES), help="meshes")
    parser.add_argument("--data", type=Path, default=environment.ROOT.parent / "shared" / "data", help="the folder of the meshes")
    parser.add_argument("--repeats", type=int, default=1, help="runs of each, of which the fastest counts")
    return parser


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the selected parts; raises FarfieldError if the input is invalid."""
    return benchmark_cli.run_parts(build_parser().parse_args(arguments), PARTS)


def measure_stretch(given: Namespace) -> dict[str, Any]:
    """Measure stretch and time of every mesh, and of other methods for those that are disks."""
    results = {}
    for name in given.models:
        item, target = open_model(given.data, name)
        uniform = np.zeros(len(target.mesh.triangles))
        settings = UnwrapSettings(**STRETCH_ONLY) if name in MAX_EXCESS_OVER_BLENDER else UnwrapSettings()
        runs = [run_timed(target, uniform, settings) for _ in range(given.repeats)]
        unwrapped, seconds = min(runs, key=lambda run: run[1])
        results[name] = {
            "triangles": len(uniform),
            "islands": unwrapped.chart_count,
            "farfield": summarize(unwrapped.metrics, seconds),
            "stages": round_seconds(unwrapped.seconds),
        }
        if name in MAX_EXCESS_OVER_BLENDER:
            for method in BLENDER_METHODS:
                results[name][method.lower()] = measure_blender(item, target, method, given.repeats)
            results[name]["xatlas"] = measure_xatlas(target.mesh, given.repeats)
            blender = results[name]["minimum_stretch"]
            results[name]["excess_over_blender"] = round((unwrapped.metrics.l2 - 1.0) / (blender["l2"] - 1.0), 3)
            results[name]["max_excess_over_blender"] = MAX_EXCESS_OVER_BLENDER[name]
            results[name]["time_over_blender"] = round(seconds / blender["seconds"], 2)
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def measure_quality_limit(given: Namespace) -> dict[str, Any]:
    """Measure L2 stretch with a minimum triangle quality over that without it."""
    results = {}
    for name in [name for name in given.models if name in MAX_EXCESS_OVER_BLENDER]:
        _, target = open_model(given.data, name)
        uniform = np.zeros(len(target.mesh.triangles))
        unlimited, _ = run_timed(target, uniform, UnwrapSettings(**STRETCH_ONLY))
        for limit in QUALITY_LIMITS:
            limited, seconds = run_timed(target, uniform, UnwrapSettings(min_quality=limit, further_cuts=False))
            ratio = round(limited.metrics.l2 / unlimited.metrics.l2, 4)
            results[f"{name} {limit}"] = {"l2_over_unlimited": ratio, **summarize(limited.metrics, seconds)}
    return results


def measure_importance(given: Namespace) -> dict[str, Any]:
    """Measure the density ratio of heads whose fronts should get four times the texels, and the stretch of these fronts."""
    results = {}
    for name in [name for name in given.models if name in HEAD_DIRECTIONS]:
        _, target = open_model(given.data, name)
        areas, normals = face_areas_and_normals(target.mesh.corners)
        front = importance.from_direction(normals, np.array(HEAD_DIRECTIONS[name]))
        uniform, _ = run_timed(target, 0.0 * front, UnwrapSettings())
        weighted, seconds = run_timed(target, front, UnwrapSettings())
        results[name] = {
            "front_l2_uniform": compute_front_l2(uniform, front, areas),
            "front_l2": compute_front_l2(weighted, front, areas),
            **summarize(weighted.metrics, seconds),
        }
    return results


def compute_front_l2(unwrapped: UnwrapResult, front: np.ndarray, areas: np.ndarray) -> float:
    """Return the L2 stretch of the front alone."""
    squares = 0.5 * (unwrapped.stretches.max_stretch**2 + unwrapped.stretches.min_stretch**2)
    return round(float(np.sqrt((squares * areas)[front > 0.5].sum() / areas[front > 0.5].sum())), 4)


def measure_cracks(given: Namespace) -> dict[str, Any]:
    """Measure the maximum stretch of the bunny, a disk with holes: L2 only, with a quality limit, and also with further cuts."""
    item, target = open_model(given.data, "stanford_bunny")
    uniform = np.zeros(len(target.mesh.triangles))
    variants = {"L2 only": UnwrapSettings(**STRETCH_ONLY)}
    variants |= {f"limit {limit}": UnwrapSettings(min_quality=limit, further_cuts=False) for limit in QUALITY_LIMITS}
    variants["limit 0.05 and further cuts"] = UnwrapSettings(min_quality=0.05)
    results = {}
    for variant, settings in variants.items():
        unwrapped, seconds = run_timed(target, uniform, settings)
        results[variant] = summarize(unwrapped.metrics, seconds)
    results["times_smaller"] = {variant: round(results["L2 only"]["linf"] / figures["linf"], 2) for variant, figures in results.items()}
    results["Blender"] = measure_blender(item, target, "MINIMUM_STRETCH", 1)
    return results


def measure_growth(_given: Namespace) -> dict[str, Any]:
    """Measure the time by number of triangles of one surface, a bumpy dome."""
    results = {}
    for count in DOME_SIZES:
        mesh = build_dome(count)
        unwrapped, seconds = run_mesh_timed(mesh, np.zeros(len(mesh.triangles)), UnwrapSettings(**STRETCH_ONLY))
        results[len(mesh.triangles)] = summarize(unwrapped.metrics, seconds)
        print(len(mesh.triangles), round(seconds, 2), file=sys.stderr)
    seconds = [figures["seconds"] for figures in results.values()]
    return {**results, "ten_to_hundred_thousand": round(seconds[2] / seconds[0], 1)}


def measure_million(_given: Namespace) -> dict[str, Any]:
    """Measure a million triangles: time, memory, and the longest time between two progress reports, after which Esc takes effect."""
    mesh = build_dome(1_000_000)
    steps = unwrap(mesh, np.arange(len(mesh.triangles)), NO_SEAMS, np.zeros(len(mesh.triangles)), UnwrapSettings(), "million")
    longest, label, started = 0.0, "", time.perf_counter()
    previous = started
    while True:
        try:
            step = next(steps)
        except StopIteration as finished:
            unwrapped = finished.value
            break
        now = time.perf_counter()
        if now - previous > longest:
            longest, label = now - previous, step.label
        previous = now
    seconds = time.perf_counter() - started
    memory = round(command_line.peak_memory_mb(), 1)
    return {
        "longest_step": round(longest, 2),
        "before": label,
        "peak_memory_mb": memory,
        **summarize(unwrapped.metrics, seconds),
        "stages": round_seconds(unwrapped.seconds),
    }


NO_SEAMS = np.zeros((0, 2), int)
PARTS = {
    "stretch": measure_stretch,
    "quality_limit": measure_quality_limit,
    "importance": measure_importance,
    "cracks": measure_cracks,
    "growth": measure_growth,
    "million": measure_million,
}


def open_model(data: Path, name: str) -> tuple[bpy.types.Object, uv_maps.UvTarget]:
    """Open a file and return its largest mesh."""
    scene_files.open_scene((data / FILES[name]).absolute())
    meshes = (item for item in bpy.context.scene.objects if item.type == "MESH")
    largest = max(meshes, key=lambda item: len(item.data.polygons))
    return largest, uv_maps.read_uv_target(largest, None)


def run_timed(target: uv_maps.UvTarget, weights: np.ndarray, settings: UnwrapSettings) -> tuple[UnwrapResult, float]:
    """Unwrap a target with the importance `weights` (T,); return the result and the seconds without measuring it."""
    started = time.perf_counter()
    unwrapped = run_to_end(unwrap(target.mesh, target.polygon_ids, target.seams, weights, settings, target.object_name))
    return unwrapped, time.perf_counter() - started - unwrapped.seconds["measure"]


def run_mesh_timed(mesh: TriangleMesh, weights: np.ndarray, settings: UnwrapSettings) -> tuple[UnwrapResult, float]:
    """Unwrap a mesh like `run_timed`, every triangle as a polygon."""
    started = time.perf_counter()
    unwrapped = run_to_end(unwrap(mesh, np.arange(len(mesh.triangles)), NO_SEAMS, weights, settings))
    return unwrapped, time.perf_counter() - started - unwrapped.seconds["measure"]


def measure_blender(item: bpy.types.Object, target: uv_maps.UvTarget, method: str, repeats: int) -> dict[str, Any]:
    """Measure the UV map of one of Blender's methods."""
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    layer = item.data.uv_layers.get("Blender") or item.data.uv_layers.new(name="Blender")
    item.data.uv_layers.active = layer
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    seconds = np.inf
    for _ in range(repeats):
        started = time.perf_counter()
        bpy.ops.uv.unwrap(method=method, margin=0.0, fill_holes=False, correct_aspect=False)
        seconds = min(seconds, time.perf_counter() - started)
    bpy.ops.object.mode_set(mode="OBJECT")
    uvs = read_uvs(item.data.uv_layers["Blender"])
    return summarize(compute_metrics(target.mesh, uvs[target.loops].astype(np.float64)), seconds)


def measure_xatlas(mesh: TriangleMesh, repeats: int) -> dict[str, Any]:
    """Measure the UV map of xatlas, which chooses the number of UV islands."""
    import xatlas

    seconds = np.inf
    for _ in range(repeats):
        started = time.perf_counter()
        atlas = xatlas.Atlas()
        atlas.add_mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
        atlas.generate()
        seconds = min(seconds, time.perf_counter() - started)
    _, triangles, uvs = atlas.get_mesh(0)
    corner_uvs = uvs[triangles].astype(np.float64) * [atlas.width, atlas.height] / max(atlas.width, atlas.height)
    return {**summarize(compute_metrics(mesh, corner_uvs), seconds), "islands": atlas.chart_count}


def compute_metrics(mesh: TriangleMesh, corner_uvs: np.ndarray) -> DistortionMetrics:
    """Return the metrics of a UV map `corner_uvs` (T, 3, 2) with uniform importance."""
    stretches = run_to_end(compute_stretches(mesh, corner_uvs))
    return run_to_end(measure_distortion(mesh, corner_uvs, stretches, np.zeros(len(corner_uvs))))


def summarize(metrics: DistortionMetrics, seconds: float) -> dict[str, Any]:
    """Return rounded metrics; None for the infinite stretch of collapsed triangles."""
    names = ("l2", "linf", "p95", "p99", "symmetric_dirichlet", "flips", "overlaps", "min_quality", "fill", "density_ratio")
    values = {name: getattr(metrics, name) for name in names}
    return {**{name: round(value, 4) if np.isfinite(value) else None for name, value in values.items()}, "seconds": round(seconds, 2)}


def round_seconds(seconds: dict[str, float]) -> dict[str, float]:
    """Round the seconds per stage."""
    return {stage: round(duration, 2) for stage, duration in seconds.items()}


def build_dome(count: int) -> TriangleMesh:
    """Build a bumpy dome of about `count` triangles that covers three quarters of a sphere: a disk."""
    side = int(np.sqrt(count / 2))
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, side + 1), np.linspace(-1.0, 1.0, side + 1), indexing="ij")
    square_radius = np.maximum(np.abs(u), np.abs(v))
    length = np.hypot(u, v)
    polar = square_radius * 0.66 * np.pi
    radius = 1.0 + 0.05 * np.sin(7.0 * u) * np.sin(5.0 * v) + 0.01 * np.sin(31.0 * u + 1.0) * np.sin(29.0 * v)
    inverse_length = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    directions = np.stack([np.sin(polar) * u * inverse_length, np.sin(polar) * v * inverse_length, np.cos(polar)], axis=-1)
    vertices = radius[..., None] * directions
    row, column = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    a = (row * (side + 1) + column).ravel()
    b, c, d = a + side + 1, a + side + 2, a + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return TriangleMesh(vertices.reshape(-1, 3), triangles.astype(np.int32))


if __name__ == "__main__":
    command_line.run(main)
