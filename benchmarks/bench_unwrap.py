"""Compares UV maps of Farfield, of Blender's Minimum Stretch, SLIM and xatlas in one process: `python3 benchmarks/bench_unwrap.py [flags]`.

Prints JSON. Parts (`--only`): `disks` (disks in one piece, compared with SLIM and Blender), `defaults` (all meshes with default settings),
`hard_surfaces` (solids, machine parts and ordinary files, compared with xatlas and Smart UV Project),
`quality_limit` (cost of a minimum triangle quality), `importance` (density ratio, and stretch of the important part), `growth` (time by
number of triangles), `million` (time, memory, and the longest time between two progress reports).
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
import unwrap_models
import unwrap_solids
from unwrap_peers import (
    compute_metrics,
    compute_seam_length,
    measure_blender,
    measure_slim,
    measure_xatlas,
    summarize,
    unwrap_with_smart_project,
    unwrap_with_xatlas,
)

from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals, longest_side
from farfield.addon.core.imaging.raster import fill_triangles
from farfield.addon.core.jobs.progress import Steps
from farfield.addon.core.unwrap import importance
from farfield.addon.core.unwrap.settings import BALANCES, UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import PACKING_END, UnwrapResult, unwrap
from lib import command_line, scene_files
from lib.contact_sheet import write_png

DISKS = ("optcuts_face", "bff_cowhead", "bff_face", "sceaux_15k", *unwrap_models.MODELS)
FILES = {
    **{name: f"meshes/{name}.obj" for name in ("optcuts_face", "bff_cowhead", "bff_face", "max_planck", "stanford_bunny")},
    "sceaux_15k": "sceaux/mesh_15k.ply",
    "sceaux_175k": "sceaux/mesh_175k.ply",
    "spot": "textured/spot/spot.obj",
    "blub": "textured/blub/blub.glb",
    "leafy_tree": "trees/leafy_tree.glb",
    "tree": "trees/tree.glb",
    "pine_tree": "trees/pine_tree.glb",
    **{f"hard_{Path(name).stem}": f"hard_surface/{name}" for name in ("fandisk.obj", "capsule.obj", "fuze.obj", "idler_riser.STL")},
    "hard_featuretype": "hard_surface/featuretype.STL",
}
HARD_FILES = {
    **{f"hard_{Path(name).stem}": f"hard_surface/{name}" for name in ("fandisk.obj", "capsule.obj", "fuze.obj", "chair_model.obj")},
    **{f"hard_{name}": f"hard_surface/{name}.STL" for name in ("1002_tray_bottom", "ADIS16480", "featuretype", "idler_riser")},
    "hard_cycloidal": "hard_surface/cycloidal.ply",
    "hard_CesiumMilkTruck": "hard_surface/CesiumMilkTruck.glb",
    **{f"ordinary_{name}": f"ordinary/{name}.glb" for name in ("alpha_blend_mode_test", "fox", "two_cylinder_engine")},
    **{f"ordinary_{name}": f"ordinary/animals/{name}.gltf" for name in ("Bunny", "Stag")},
    **{f"ordinary_{name}": f"ordinary/{name}/{name}.gltf" for name in ("castle", "chopper")},
    "ordinary_knight": "ordinary/knight/knight_size_test.glb",
    "ordinary_pumpkin_knight": "ordinary/pumpkin_knight/scene.gltf",
    "ordinary_sheen_chair": "ordinary/sheen_chair/MixedLightingExample.gltf",
}
MAP_SIDE = 512  # Pixels of a drawn map.
HEAD_DIRECTIONS = {"max_planck": (0.0, 0.0, 1.0), "bff_face": (0.0, -0.36, 0.93), "optcuts_face": (0.0, -1.0, 0.0)}
ONE_PIECE = {"further_cuts": False}
QUALITY_LIMITS = (0.05, 0.1, 0.15)
DOME_SIZES = 10_000, 30_000, 100_000, 300_000


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_unwrap.py", __doc__, PARTS)
    parser.add_argument(
        "--models", nargs="+", choices=[*FILES, *unwrap_models.MODELS], default=[*FILES, *unwrap_models.MODELS], help="meshes"
    )
    parser.add_argument("--data", type=Path, default=environment.ROOT.parent / "shared" / "data", help="the folder of the meshes")
    parser.add_argument("--maps", type=Path, help="a folder for pictures of the maps of hard surfaces")
    parser.add_argument("--repeats", type=int, default=1, help="runs of each, of which the fastest counts")
    return parser


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the selected parts; raises FarfieldError if the input is invalid."""
    return benchmark_cli.run_parts(build_parser().parse_args(arguments), PARTS)


def measure_disks(given: Namespace) -> dict[str, Any]:
    """Measure disks in one piece: all balances of Farfield, SLIM, and Blender."""
    results = {}
    for name in [name for name in given.models if name in DISKS]:
        item, target = open_model(given.data, name)
        uniform = np.zeros(len(target.mesh.triangles))
        results[name] = {"triangles": len(uniform)}
        for balance in BALANCES:
            runs = [run_timed(target, uniform, UnwrapSettings(balance=balance, **ONE_PIECE)) for _ in range(given.repeats)]
            unwrapped, seconds = min(runs, key=lambda run: run[1])
            results[name][balance] = summarize(unwrapped.metrics, seconds)
        results[name]["minimum_stretch"] = measure_blender(item, target, given.repeats)
        slim = results[name]["slim"] = measure_slim(target.mesh)
        if slim is not None:
            figures = results[name]["balanced"]
            results[name]["symmetric_dirichlet_over_slim"] = round(figures["symmetric_dirichlet"] / slim["symmetric_dirichlet"], 4)
            results[name]["l2_excess_over_slim"] = round((figures["l2"] - 1.0) / (slim["l2"] - 1.0), 3)
            results[name]["needles_minus_slim"] = round(figures["needles"] - slim["needles"], 4)
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def measure_defaults(given: Namespace) -> dict[str, Any]:
    """Measure every mesh with default settings, and xatlas."""
    results = {}
    for name in given.models:
        _, target = open_model(given.data, name)
        uniform = np.zeros(len(target.mesh.triangles))
        unwrapped, seconds = min((run_timed(target, uniform, UnwrapSettings()) for _ in range(given.repeats)), key=lambda run: run[1])
        results[name] = {
            "triangles": len(uniform),
            "islands": unwrapped.chart_count,
            "farfield": summarize(unwrapped.metrics, seconds),
            "stages": round_seconds(unwrapped.seconds),
            "xatlas": measure_xatlas(target.mesh, given.repeats),
        }
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def measure_hard_surfaces(given: Namespace) -> dict[str, Any]:
    """Measure solids and the largest meshes of machine parts and ordinary files with default settings, xatlas and Smart UV Project."""
    results = {}
    if given.maps is not None:
        given.maps.mkdir(parents=True, exist_ok=True)
    for name in [*unwrap_solids.SOLIDS, *(name for name in HARD_FILES if (given.data / HARD_FILES[name]).exists())]:
        item, target = open_model(given.data, name)
        settings, uniform = UnwrapSettings(), np.zeros(len(target.mesh.triangles))
        margin = settings.margin / settings.texture_size[0]
        unwrapped, seconds = min((run_timed(target, uniform, settings) for _ in range(given.repeats)), key=lambda run: run[1])
        maps = {"farfield": (unwrapped.corner_uvs, seconds)}
        unit = TriangleMesh(target.mesh.vertices * (10.0 / longest_side(target.mesh.vertices)), target.mesh.triangles)
        started = time.process_time()
        maps["xatlas"] = unwrap_with_xatlas(unit, margin)[0], time.process_time() - started
        started = time.process_time()
        maps["smart_project"] = unwrap_with_smart_project(item, target.loops, margin), time.process_time() - started
        figures = {method: summarize(compute_metrics(unit, uvs), seconds) for method, (uvs, seconds) in maps.items()}
        for method, (uvs, _) in maps.items():
            figures[method]["seam"] = round(compute_seam_length(unit, uvs), 3)
            if given.maps is not None:
                normals = face_areas_and_normals(unit.corners)[1]
                write_png(given.maps / f"{name} {method}.png", draw_normals(uvs, normals))
        farfield, peers = figures["farfield"], [figures["xatlas"], figures["smart_project"]]
        results[name] = {
            "triangles": len(uniform),
            "islands": unwrapped.chart_count,
            "seam_over_best": round(farfield["seam"] / max(min(peer["seam"] for peer in peers), 1e-9), 3),
            "fill_over_best": round(farfield["fill"] / max(peer["fill"] for peer in peers), 3),
            **figures,
        }
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def draw_normals(corner_uvs: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return an image (MAP_SIDE, MAP_SIDE, 3) of a UV map, colored by the `normals` (T, 3) of its triangles."""
    colors = (0.55 + 0.4 * normals).astype(np.float32)
    return fill_triangles(corner_uvs * MAP_SIDE, colors, (MAP_SIDE, MAP_SIDE), 0.1)


def measure_quality_limit(given: Namespace) -> dict[str, Any]:
    """Measure L2 stretch with a minimum triangle quality over that without it."""
    results = {}
    for name in [name for name in given.models if name in DISKS]:
        _, target = open_model(given.data, name)
        uniform = np.zeros(len(target.mesh.triangles))
        unlimited, _ = run_timed(target, uniform, UnwrapSettings(**ONE_PIECE))
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


def measure_growth(_given: Namespace) -> dict[str, Any]:
    """Measure the time by number of triangles of one surface, a bumpy dome."""
    results = {}
    for count in DOME_SIZES:
        mesh = build_dome(count)
        unwrapped, seconds = run_mesh_timed(mesh, np.zeros(len(mesh.triangles)), UnwrapSettings(**ONE_PIECE))
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
    "disks": measure_disks,
    "defaults": measure_defaults,
    "hard_surfaces": measure_hard_surfaces,
    "quality_limit": measure_quality_limit,
    "importance": measure_importance,
    "growth": measure_growth,
    "million": measure_million,
}


def open_model(data: Path, name: str) -> tuple[bpy.types.Object, uv_maps.UvTarget]:
    """Open a file, or build a model, and return its largest mesh."""
    if name in unwrap_models.MODELS or name in unwrap_solids.SOLIDS:
        model = unwrap_solids.SOLIDS[name]() if name in unwrap_solids.SOLIDS else unwrap_models.build_model(name)
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(model.vertices, [], model.triangles.tolist())
        item = bpy.data.objects.new(name, mesh)
        bpy.context.scene.collection.objects.link(item)
        bpy.context.view_layer.update()
        return item, uv_maps.read_uv_target(item, None)
    else:
        scene_files.open_scene((data / {**FILES, **HARD_FILES}[name]).absolute())
    meshes = (item for item in bpy.context.scene.objects if item.type == "MESH")
    largest = max(meshes, key=lambda item: len(item.data.polygons))
    return largest, uv_maps.read_uv_target(largest, None)


def run_timed(target: uv_maps.UvTarget, weights: np.ndarray, settings: UnwrapSettings) -> tuple[UnwrapResult, float]:
    """Unwrap a target with the importance `weights` (T,); return the result and the seconds of CPU time without measuring it."""
    return time_steps(unwrap(target.mesh, target.polygon_ids, target.seams, weights, settings, target.object_name))


def run_mesh_timed(mesh: TriangleMesh, weights: np.ndarray, settings: UnwrapSettings) -> tuple[UnwrapResult, float]:
    """Unwrap a mesh like `run_timed`, every triangle as a polygon."""
    return time_steps(unwrap(mesh, np.arange(len(mesh.triangles)), NO_SEAMS, weights, settings))


def time_steps(steps: Steps[UnwrapResult]) -> tuple[UnwrapResult, float]:
    """Run an unwrap; return its result and the seconds of CPU time until its metrics are computed."""
    started, seconds = time.process_time(), 0.0
    while True:
        try:
            step = next(steps)
        except StopIteration as finished:
            return finished.value, seconds
        if not seconds and step.label == "Measuring" and step.fraction >= PACKING_END:
            seconds = time.process_time() - started


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
