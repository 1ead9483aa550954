"""Performance of terrain in nested boxes: `python3 benchmarks/bench_clipbox.py [flags]`.

Prints JSON. Parts (`--only`): `memory` (of a separate process), `build` (first builds, shown in Blender), `step` (the innermost box moves
by one voxel; the longest tick of the main thread), `lag` (behind a fast viewer), `flight` (reused voxels), `extraction` (a surface
compared with marching cubes of scikit-image on the same volume, alternating), `spheres` (50,000 of them, and the cost of distant ones),
`cracks` (after random moves, surfaces are closed and equal builds from scratch), `borders` (walls where boxes meet).
"""

import json
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import bpy
import numpy as np

from farfield.addon.bridge.clipbox.objects import LEFT_OUT_KEY
from farfield.addon.core.clipbox.blocks import BlockMesh
from farfield.addon.core.clipbox.clearings import find_clearing
from farfield.addon.core.clipbox.engine import TerrainEngine, weld
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains import spheres
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.clipbox.job import prepare
from farfield.addon.operators.following import Following, ViewerPath
from farfield.addon.operators.job_run import run_job
from lib import command_line

sys.path.append(str(environment.ROOT / "tests"))

from clipbox_borders import count_walls
from surface_extraction import extract_surface

START = np.array([0.0, 0.0, 40.0])
SPEEDS, SECONDS_OF_FLIGHT = (10.0, 40.0, 160.0, 640.0), 8.0  # Scene units per second.
IDLE_MS = 0.2  # Ticks that take less of the CPU wait for the engine.
FRAME_SECONDS = 1.0 / 60.0  # between two timer events of a window


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_clipbox.py", __doc__, PARTS)
    parser.add_argument("--terrain", default="cascades", help="the terrain to measure")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each measurement, of which the fastest counts")
    parser.add_argument("--steps", type=int, default=100, help="steps of one voxel")
    parser.add_argument("--moves", type=int, default=500, help="random moves")
    return parser


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Measure and return the results as JSON; raises FarfieldError if the input is invalid."""
    return benchmark_cli.run_parts(build_parser().parse_args(arguments), PARTS)


def build(given: Namespace) -> dict[str, Any]:
    """Measure the seconds of the first build of seven boxes, including Blender meshes."""
    figures = {}
    for resolution, bound in ((128, 6.0), (64, 1.2)):
        seconds = []
        for _ in range(given.repeats):
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            started = time.perf_counter()
            job = prepare(ClipboxSettings(terrain=given.terrain, resolution=resolution), START)
            run_to_end(run_job(job))
            seconds.append(time.perf_counter() - started)
        triangles = sum(box["triangles"] for box in job.engine.statistics())
        stages = {stage: round(duration, 3) for stage, duration in job.engine.clock.seconds.items()}
        figures[str(resolution)] = {
            "seconds": round_to_milliseconds(seconds),
            "bound": bound,
            "triangles": triangles,
            "stages_of_last": stages,
        }
    return figures


def step(given: Namespace) -> dict[str, Any]:
    """Measure the milliseconds from a viewer step of one voxel to the shown meshes, and of the ticks of the main thread that do something.

    With a threshold of one voxel every step moves boxes, with the default one only some do.
    """
    figures = {}
    for resolution, threshold in ((128, 1), (128, 4), (64, 1)):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        job = prepare(ClipboxSettings(terrain=given.terrain, resolution=resolution, threshold=threshold), START)
        run_to_end(run_job(job))
        following, seconds, ticks, cpu = Following(job.terrain), [], [], []
        directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        position = START.copy()
        for index in range(given.steps):
            position = position + directions[index * len(directions) // given.steps]
            started = time.perf_counter()
            while not following.is_settled(position):
                tick_started, cpu_started = time.perf_counter(), time.thread_time()
                following.tick(position)
                ticks.append(1e3 * (time.perf_counter() - tick_started))
                cpu.append(1e3 * (time.thread_time() - cpu_started))
                time.sleep(max(0.0, FRAME_SECONDS - (time.perf_counter() - tick_started)))
            seconds.append(time.perf_counter() - started)
        following.close()
        figures[f"{resolution}, threshold {threshold}"] = {
            "moves": following.moves,
            "mean_ms": round(1e3 * float(np.mean(seconds)), 1),
            "median_ms": round(1e3 * float(np.median(seconds)), 1),
            "max_ms": round(1e3 * max(seconds), 1),
            "longest_tick_ms": round(1e3 * following.longest_tick, 1),
            "bounds_ms": [150, 16],
            "ticks_ms": summarize_ticks(ticks, cpu),
            "ticks_cpu_ms": summarize_ticks(cpu, cpu),
            "tick_bounds_ms": [8, 16],
        }
    return figures


def summarize_ticks(milliseconds: list[float], cpu: list[float]) -> list[float]:
    """Return the median and the 95th percentile of the ticks that took CPU time."""
    works = np.array(milliseconds)[np.array(cpu) > IDLE_MS]
    return np.round(np.percentile(works, (50.0, 95.0)), 1).tolist()


def lag(given: Namespace) -> dict[str, Any]:
    """Measure how far the terrain is behind a viewer of constant speed, and the fraction of time in which the viewer is outside the
    innermost box that is shown, with and without leaving out boxes."""
    figures = {}
    settings = ClipboxSettings(terrain=given.terrain)
    for speed in SPEEDS:
        for name, context in (("boxes left out", nullcontext()), ("all boxes", patch.object(ViewerPath, "speed", 0.0))):
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            job = prepare(settings, START)
            run_to_end(run_job(job))
            following, lags, outside = Following(job.terrain), [], []
            started = time.perf_counter()
            with context:
                while (elapsed := time.perf_counter() - started) < SECONDS_OF_FLIGHT:
                    viewer = START + [elapsed * speed, 0.0, 0.0]
                    following.tick(viewer)
                    lags.append(float(np.linalg.norm(viewer - job.terrain.viewer)))
                    left_out = job.terrain.root.get(LEFT_OUT_KEY, 0)
                    outside.append(lags[-1] > 0.5 * settings.extent_of(left_out))
                    time.sleep(max(0.0, FRAME_SECONDS - (time.perf_counter() - started - elapsed)))
            following.close()
            late = len(lags) // 2  # The first moves are not typical.
            figures[f"{speed:g} units per second, {name}"] = {
                "mean_lag": round(float(np.mean(lags[late:])), 1),
                "max_lag": round(max(lags[late:]), 1),
                "outside": round(float(np.mean(outside[late:])), 3),
                "moves": following.moves,
            }
    return figures


def flight(given: Namespace) -> dict[str, Any]:
    """Measure the fraction of voxels that moves reuse, by box, on 200 steps of a flight with varying speed."""
    engine = TerrainEngine(ClipboxSettings(terrain=given.terrain, resolution=128))
    position, heading = START.copy(), 0.0
    random = np.random.default_rng(3)
    run_to_end(engine.move(position))
    for _ in range(200):
        heading += random.normal(scale=0.15)
        position = position + random.uniform(0.5, 8.0) * np.array([np.cos(heading), np.sin(heading), random.normal(scale=0.1)])
        run_to_end(engine.move(position))
    boxes = engine.statistics()
    computed, reused = (sum(box[name] for box in boxes) for name in ("computed", "reused"))
    reused_fraction = reused / (reused + computed - engine.initial_voxels)
    return {"reused_fraction": round(reused_fraction, 4), "by_box": [box["reused_fraction"] for box in boxes], "bound": 0.8}


def extraction(given: Namespace) -> dict[str, Any]:
    """Compare the extraction of one 128^3 box, smooth and blocky, with marching cubes with shared vertices."""
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        return {"skipped": "scikit-image is not installed"}
    figures = {}
    for name in dict.fromkeys((given.terrain, "spheres", "islands")):
        grid = Grid((-64, -64, -64), (128, 128, 128), 1.0)
        volume = build_sampler(ClipboxSettings(terrain=name)).densities(grid).astype(np.float32)
        runs: dict[str, list[float]] = {"smooth": [], "blocky": [], "marching_cubes": []}
        for _ in range(given.repeats):
            for method, function in (
                ("smooth", lambda: extract_surface(volume)),  # noqa: B023
                ("blocky", lambda: extract_surface(volume, blocky=True)),  # noqa: B023
                ("marching_cubes", lambda: marching_cubes(volume, 0.0)),  # noqa: B023
            ):
                started = time.perf_counter()
                function()
                runs[method].append(time.perf_counter() - started)
        best = {method: min(seconds) for method, seconds in runs.items()}
        figures[name] = {
            "triangles": 2 * len(extract_surface(volume).quads),
            "seconds": {method: round(seconds, 4) for method, seconds in best.items()},
            "smooth_over_marching_cubes": round(best["smooth"] / best["marching_cubes"], 2),
            "blocky_over_marching_cubes": round(best["blocky"] / best["marching_cubes"], 2),
            "bounds": [1.0, 0.35],
        }
    return figures


def sphere_csg(given: Namespace) -> dict[str, Any]:
    """Measure spheres in one 128^3 box: more than 50,000 of the terrain's, random ones, and a hundred times as many outside the box."""
    grid, random, figures = Grid((-64, -64, -64), (128, 128, 128), 1.0), np.random.default_rng(1), {}
    field = spheres.SphereField(max_radius=120.0, class_count=7, spheres_per_cell=8, subtracted_fraction=0.5, max_height=600.0, seed=0)
    seconds = best_of(given.repeats, lambda: spheres.csg_density(grid, spheres.find_touching_spheres(field, grid)))
    touching = len(spheres.find_touching_spheres(field, grid).radii)
    figures["seven classes, radii to 120"] = {"seconds": round(seconds, 4), "bound": 0.4, "spheres_touching": touching}
    for name, max_radius, extent, count in (
        ("50,000 around it, radii to 24", 24.0, 512.0, 50_000),
        ("50,000 touch it, radii to 4", 4.0, 64.0, 50_000),
        ("50,000 touch it, radii to 8", 8.0, 64.0, 50_000),
    ):
        scattered = spheres.Spheres(
            random.uniform(-extent, extent, (count, 3)), random.uniform(0.5, 1.0, count) * max_radius, np.arange(count) >= count // 2
        )
        seconds = best_of(given.repeats, lambda: spheres.csg_density(grid, scattered))  # noqa: B023
        figures[name] = {"seconds": round(seconds, 4), "bound": 0.4}
    for name, height in (("field 100 high", 50.0), ("field 10,000 high", 5000.0)):
        field = spheres.SphereField(max_radius=24.0, class_count=3, spheres_per_cell=8, subtracted_fraction=0.45, max_height=height, seed=1)
        seconds = best_of(given.repeats, lambda: spheres.csg_density(grid, spheres.find_touching_spheres(field, grid)))  # noqa: B023
        figures[name] = {"seconds": round(seconds, 4), "spheres_touching": len(spheres.find_touching_spheres(field, grid).radii)}
    return figures


def cracks(given: Namespace) -> dict[str, Any]:
    """Count open edges, edges of more than two faces, and blocks unlike those of a build from scratch, over random moves of small boxes."""
    figures = {"moves": 0, "open_edges": 0, "edges_of_more_than_two_faces": 0, "blocks_unlike_scratch": 0, "blocks_compared": 0}
    variants = (
        {},
        {"terrain": "spheres"},
        {"subdivided_boxes": 1},
        {"surface": "blocky", "smoothing": 2},
        {"surface": "blocky", "subdivided_boxes": 2},
    )
    for variant in variants:
        settings = ClipboxSettings(**({"terrain": given.terrain, "resolution": 32, "boxes": 4} | variant))
        engine, shown = TerrainEngine(settings), {}
        for position in random_positions(given.moves // len(variants), seed=len(variant)):
            update = run_to_end(engine.move(position))
            shown = {key: mesh for key, mesh in shown.items() if key not in update.removed and not update.is_complete} | update.meshes
            fresh = run_to_end(TerrainEngine(settings).move(position)).meshes
            figures["moves"] += 1
            figures["blocks_compared"] += len(fresh)
            figures["blocks_unlike_scratch"] += sum(key not in shown or differs(shown[key], fresh[key]) for key in fresh) + len(
                set(shown) - set(fresh)
            )
            for name, count in count_bad_edges(engine, list(shown.values())).items():
                figures[name] += count
    return figures


def random_positions(count: int, seed: int) -> Iterator[np.ndarray]:
    """Yield the positions of a viewer who walks, runs and jumps."""
    random, position = np.random.default_rng(seed), START.copy()
    for _ in range(count):
        position = position + random.normal(size=3) * random.choice([0.7, 3.0, 25.0]) * [1.0, 1.0, 0.3]
        position[2] = np.clip(position[2], -40.0, 60.0)
        yield position


def differs(block: BlockMesh, other: BlockMesh) -> bool:
    """Return whether two blocks differ in any byte."""
    names = ("corners", "cycles", "vertices", "normals", "triangles")
    return any(getattr(block, name).tobytes() != getattr(other, name).tobytes() for name in names)


def count_bad_edges(engine: TerrainEngine, meshes: list[BlockMesh]) -> dict[str, int]:
    """Count the edges inside the outermost box with one face, and edges with more than two."""
    mesh = weld(meshes)
    edges = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    count = len(mesh.vertices)
    forward, backward = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    open_edges = edges[~np.isin(forward, backward)]
    visible, voxel_size = engine.boxes.layout.visible[-1], engine.boxes.grid(engine.boxes.coarsest_level).voxel_size
    low, high = visible.low * voxel_size, visible.high * voxel_size
    on_boundary = (np.isclose(mesh.vertices, low) | np.isclose(mesh.vertices, high)).any(axis=1)
    return {
        "open_edges": int((~on_boundary[open_edges].all(axis=1)).sum()),
        "edges_of_more_than_two_faces": len(forward) - len(np.unique(forward)),
    }


def borders(given: Namespace) -> dict[str, Any]:
    """Count faces between ground and air at the borders of boxes, and how many of them are walls, around three viewers."""
    settings = ClipboxSettings(terrain=given.terrain)
    sampler, random = build_sampler(settings), np.random.default_rng(1)
    viewers = [find_clearing(sampler, np.array([*random.uniform(-500.0, 500.0, 2), START[2] - 80.0]), 1.0) for _ in range(3)]
    return {"boxes": count_walls(sampler, settings, np.array(viewers)), "bound": 0}


def memory(given: Namespace) -> dict[str, Any]:
    """Measure the peak memory of a process that builds seven boxes of 128^3, compared with one that builds almost nothing."""
    flags = ["--terrain", given.terrain, "--resolution", "128", "--at", "0,0,40"]
    script = environment.ROOT / "scripts" / "clipbox.py"
    figures = {}
    for name, size_flags in (("7 x 128^3", ["--boxes", "7"]), ("1 x 32^3", ["--boxes", "1", "--resolution", "32"])):
        report, out = environment.ROOT / "out" / "benchmark-report.json", environment.ROOT / "out" / "benchmark.blend"
        report.parent.mkdir(exist_ok=True)
        command = [sys.executable, str(script), *flags, *size_flags, "--out", str(out), "--report", str(report)]
        subprocess.run(command, check=True, capture_output=True)
        figures[name] = {"peak_memory_mb": json.loads(report.read_text(encoding="utf-8"))["peak_memory_mb"]}
        report.unlink(), out.unlink()
    return figures | {"bound": 600}


def best_of(repeats: int, function: Callable[[], Any]) -> float:
    """Return the seconds of the fastest run."""
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def round_to_milliseconds(seconds: list[float]) -> list[float]:
    return [round(duration, 3) for duration in seconds]


PARTS = {  # memory first, because a child process inherits the peak memory of its parent
    "memory": memory,
    "build": build, "step": step, "lag": lag, "flight": flight, "extraction": extraction, "spheres": sphere_csg, "cracks": cracks,
    "borders": borders,
}  # fmt: skip


if __name__ == "__main__":
    command_line.run(main)
