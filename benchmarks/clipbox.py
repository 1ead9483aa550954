"""Terrain in nested boxes, measured: `python3 benchmarks/clipbox.py [flags]`.

Prints JSON. Parts (`--only`): `memory` (of a process of its own), `build` (first builds, shown in Blender), `step` (the innermost box one
voxel on, shown; the longest slice of the main thread), `flight` (voxels kept), `extraction` (a surface beside scikit-image's marching cubes
on the same volume, in turn), `spheres` (50,000 of them, and how little others elsewhere cost), `cracks` (random moves: closed, and equal to
builds from scratch).
"""

import json
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

import environment

environment.ensure()

import bpy
import numpy as np
import parts

import command_line
from farfield.addon.core.clipbox import spheres
from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.surface import surface_of
from farfield.addon.core.clipbox.terrain import Terrain, welded
from farfield.addon.core.clipbox.terrains import terrain_of
from farfield.addon.core.progress import finish
from farfield.addon.operators import clipbox_job
from farfield.addon.operators.clipbox_following import Following
from farfield.addon.operators.long_work import whole

START = np.array([0.0, 0.0, 40.0])
FRAME = 1.0 / 60.0  # seconds between two looks of a window at its timers


def parser() -> command_line.Parser:
    """All arguments of the benchmark."""
    made = parts.parser("clipbox.py", __doc__, PARTS)
    made.add_argument("--terrain", default="cascades", help="the terrain to measure on")
    made.add_argument("--repeats", type=int, default=3, help="runs of each, of which the fastest counts")
    made.add_argument("--steps", type=int, default=100, help="steps of one voxel")
    made.add_argument("--moves", type=int, default=500, help="random moves")
    return made


def main(arguments: list[str], _line: command_line.ProgressLine) -> None:
    """Measure; raises FarfieldError when the input is bad."""
    parts.measure(parser().parse_args(arguments), PARTS)


def build(given: Namespace) -> dict[str, Any]:
    """Seconds of the first build of seven boxes, meshes in Blender included."""
    found = {}
    for resolution, bound in ((128, 6.0), (64, 1.2)):
        seconds = []
        for _ in range(given.repeats):
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            started = time.perf_counter()
            job = clipbox_job.prepare(ClipboxSettings(terrain=given.terrain, resolution=resolution), START)
            finish(whole(job))
            seconds.append(time.perf_counter() - started)
        triangles = sum(box["triangles"] for box in job.engine.figures())
        stages = {stage: round(taken, 3) for stage, taken in job.engine.clock.seconds.items()}
        found[str(resolution)] = {"seconds": rounded(seconds), "bound": bound, "triangles": triangles, "stages_of_last": stages}
    return found


def step(given: Namespace) -> dict[str, Any]:
    """Milliseconds from a viewer's step of one voxel to the swapped meshes, and of the main thread in one go; with a threshold of one voxel
    every step is followed, with the default one only some are."""
    found = {}
    for resolution, threshold in ((128, 1), (128, 4), (64, 1)):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        job = clipbox_job.prepare(ClipboxSettings(terrain=given.terrain, resolution=resolution, threshold=threshold), START)
        finish(whole(job))
        following, seconds = Following(job.standing), []
        directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        place = START.copy()
        for number in range(given.steps):
            place = place + directions[number * len(directions) // given.steps]
            started = time.perf_counter()
            while not following.settled(place):
                ticked = time.perf_counter()
                following.tick(place)
                time.sleep(max(0.0, FRAME - (time.perf_counter() - ticked)))
            seconds.append(time.perf_counter() - started)
        following.close()
        found[f"{resolution}, threshold {threshold}"] = {
            "moves": following.moves,
            "mean_ms": round(1e3 * float(np.mean(seconds)), 1),
            "median_ms": round(1e3 * float(np.median(seconds)), 1),
            "largest_ms": round(1e3 * max(seconds), 1),
            "longest_slice_ms": round(1e3 * following.longest_slice, 1),
            "bounds_ms": [150, 16],
        }
    return found


def flight(given: Namespace) -> dict[str, Any]:
    """The share of voxels that moves keep, by box, on 200 steps of a flight whose speed changes."""
    engine = Terrain(ClipboxSettings(terrain=given.terrain, resolution=128))
    place, heading = START.copy(), 0.0
    random = np.random.default_rng(3)
    finish(engine.move(place))
    for _ in range(200):
        heading += random.normal(scale=0.15)
        place = place + random.uniform(0.5, 8.0) * np.array([np.cos(heading), np.sin(heading), random.normal(scale=0.1)])
        finish(engine.move(place))
    boxes = engine.figures()
    computed, reused = (sum(box[name] for box in boxes) for name in ("computed", "reused"))
    share = reused / (reused + computed - engine.first_computed)
    return {"reused_share": round(share, 4), "by_box": [box["reused_share"] for box in boxes], "bound": 0.8}


def extraction(given: Namespace) -> dict[str, Any]:
    """A surface with shared vertices of one 128^3 box beside marching cubes, smooth and blocky."""
    try:
        from skimage.measure import marching_cubes
    except ImportError:
        return {"left out": "scikit-image is not installed"}
    found = {}
    for name in dict.fromkeys((given.terrain, "spheres", "islands")):
        grid = Grid((-64, -64, -64), (128, 128, 128), 1.0)
        volume = terrain_of(ClipboxSettings(terrain=name)).densities(grid).astype(np.float32)
        runs: dict[str, list[float]] = {"smooth": [], "blocky": [], "marching_cubes": []}
        for _ in range(given.repeats):
            for kind, function in (
                ("smooth", lambda: surface_of(volume)),  # noqa: B023
                ("blocky", lambda: surface_of(volume, blocky=True)),  # noqa: B023
                ("marching_cubes", lambda: marching_cubes(volume, 0.0)),  # noqa: B023
            ):
                started = time.perf_counter()
                function()
                runs[kind].append(time.perf_counter() - started)
        best = {kind: min(seconds) for kind, seconds in runs.items()}
        found[name] = {
            "triangles": 2 * len(surface_of(volume).quads),
            "seconds": {kind: round(seconds, 4) for kind, seconds in best.items()},
            "smooth_over_marching_cubes": round(best["smooth"] / best["marching_cubes"], 2),
            "blocky_over_marching_cubes": round(best["blocky"] / best["marching_cubes"], 2),
            "bounds": [1.0, 0.35],
        }
    return found


def sphere_csg(given: Namespace) -> dict[str, Any]:
    """Spheres in one 128^3 box: 50,000 and more of the terrain's, strewn ones, and what a hundred times as many elsewhere cost."""
    grid, random, found = Grid((-64, -64, -64), (128, 128, 128), 1.0), np.random.default_rng(1), {}
    field = spheres.SphereField(largest=120.0, classes=7, count=8, taken=0.5, height=600.0, seed=0)
    seconds = best_of(given.repeats, lambda: spheres.carved(grid, spheres.spheres_touching(field, grid)))
    touching = len(spheres.spheres_touching(field, grid).radii)
    found["seven classes, radii to 120"] = {"seconds": round(seconds, 4), "bound": 0.4, "spheres_touching": touching}
    for name, radius, spread, count in (
        ("50,000 about it, radii to 24", 24.0, 512.0, 50_000),
        ("50,000 touch it, radii to 4", 4.0, 64.0, 50_000),
        ("50,000 touch it, radii to 8", 8.0, 64.0, 50_000),
    ):
        strewn = spheres.Spheres(
            random.uniform(-spread, spread, (count, 3)), random.uniform(0.5, 1.0, count) * radius, np.arange(count) >= count // 2
        )
        seconds = best_of(given.repeats, lambda: spheres.carved(grid, strewn))  # noqa: B023
        found[name] = {"seconds": round(seconds, 4), "bound": 0.4}
    for name, height in (("field 100 high", 50.0), ("field 10,000 high", 5000.0)):
        field = spheres.SphereField(largest=24.0, classes=3, count=8, taken=0.45, height=height, seed=1)
        seconds = best_of(given.repeats, lambda: spheres.carved(grid, spheres.spheres_touching(field, grid)))  # noqa: B023
        found[name] = {"seconds": round(seconds, 4), "spheres_touching": len(spheres.spheres_touching(field, grid).radii)}
    return found


def cracks(given: Namespace) -> dict[str, Any]:
    """Random moves of small boxes: open edges, edges of more than two faces, and blocks that differ from those of a build from scratch."""
    found = {"moves": 0, "open_edges": 0, "edges_of_more_than_two_faces": 0, "blocks_unlike_scratch": 0, "blocks_compared": 0}
    kinds = ({}, {"terrain": "spheres"}, {"subdivided": 1}, {"surface": "blocky", "smoothing": 2}, {"surface": "blocky", "subdivided": 2})
    for kind in kinds:
        settings = ClipboxSettings(**({"terrain": given.terrain, "resolution": 32, "boxes": 4} | kind))
        engine, shown = Terrain(settings), {}
        for place in random_places(given.moves // len(kinds), seed=len(kind)):
            update = finish(engine.move(place))
            shown = {key: mesh for key, mesh in shown.items() if key not in update.gone and not update.whole} | update.meshes
            fresh = finish(Terrain(settings).move(place)).meshes
            found["moves"] += 1
            found["blocks_compared"] += len(fresh)
            found["blocks_unlike_scratch"] += sum(key not in shown or unlike(shown[key], fresh[key]) for key in fresh) + len(
                set(shown) - set(fresh)
            )
            for name, count in open_and_crowded(engine, list(shown.values())).items():
                found[name] += count
    return found


def random_places(count: int, seed: int) -> Iterator[np.ndarray]:
    """Places of a viewer who walks, runs and jumps."""
    random, place = np.random.default_rng(seed), START.copy()
    for _ in range(count):
        place = place + random.normal(size=3) * random.choice([0.7, 3.0, 25.0]) * [1.0, 1.0, 0.3]
        place[2] = np.clip(place[2], -40.0, 60.0)
        yield place


def unlike(one: Any, other: Any) -> bool:
    """Whether two blocks differ in any byte."""
    names = ("corners", "rings", "vertices", "normals", "triangles")
    return any(getattr(one, name).tobytes() != getattr(other, name).tobytes() for name in names)


def open_and_crowded(engine: Terrain, meshes: list[Any]) -> dict[str, int]:
    """Edges within the outermost box with one face, and edges with more than two."""
    made = welded(meshes)
    edges = np.stack([made.triangles, np.roll(made.triangles, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)
    count = len(made.vertices)
    forward, backward = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    lone = edges[~np.isin(forward, backward)]
    shown, voxel = engine.boxes.layout.shown[-1], engine.boxes.volume(engine.boxes.coarsest).voxel
    rim = (np.isclose(made.vertices, shown.low * voxel) | np.isclose(made.vertices, shown.high * voxel)).any(axis=1)
    return {
        "open_edges": int((~rim[lone].all(axis=1)).sum()),
        "edges_of_more_than_two_faces": len(forward) - len(np.unique(forward)),
    }


def memory(given: Namespace) -> dict[str, Any]:
    """Peak memory of a process that builds seven boxes of 128^3 and follows, beside one that imports the same and does nothing."""
    flags = ["--terrain", given.terrain, "--resolution", "128", "--at", "0,0,40"]
    script = environment.ROOT / "scripts" / "clipbox.py"
    found = {}
    for name, more in (("7 x 128^3", ["--boxes", "7"]), ("1 x 32^3", ["--boxes", "1", "--resolution", "32"])):
        report, out = environment.ROOT / "out" / "benchmark-report.json", environment.ROOT / "out" / "benchmark.blend"
        report.parent.mkdir(exist_ok=True)
        subprocess.run(
            [sys.executable, str(script), *flags, *more, "--out", str(out), "--report", str(report)], check=True, capture_output=True
        )
        found[name] = {"peak_memory_mb": json.loads(report.read_text(encoding="utf-8"))["peak_memory_mb"]}
        report.unlink(), out.unlink()
    return found | {"bound": 600}


def best_of(repeats: int, function: Any) -> float:
    """Seconds of the fastest run."""
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def rounded(seconds: list[float]) -> list[float]:
    """Milliseconds are enough."""
    return [round(each, 3) for each in seconds]


PARTS = {  # memory first: a process hands on how large it has been to those that it starts
    "memory": memory,
    "build": build, "step": step, "flight": flight, "extraction": extraction, "spheres": sphere_csg, "cracks": cracks,
}  # fmt: skip


if __name__ == "__main__":
    command_line.run(main)
