"""UV maps of ours, of Blender's three methods and of xatlas, side by side in one process: `python3 benchmarks/unwrap.py [flags]`.

Prints JSON. Parts (`--only`): `stretch` (of all meshes, and time; peers where a mesh is a disk), `barrier` (what a bound on shape costs),
`importance` (density ratio and stretch of what matters), `cracks` (largest stretch on the bunny with and without the bound), `growth`
(time by number of triangles), `million` (time, memory, and the longest wait between two steps).
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

import environment

environment.ensure()

import bpy
import numpy as np
import parts

import command_line
import scene_files
from farfield.addon.bridge import uv_maps
from farfield.addon.core.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap import importance
from farfield.addon.core.unwrap.measures import Measures, measured, stretches_of
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import Unwrapped, unwrap

DISKS = {"optcuts_face": 0.70, "bff_cowhead": 0.70, "bff_face": 0.85, "sceaux_15k": 0.85}  # the bound on excess stretch over Blender's
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
HEADS = {"max_planck": (0.0, 0.0, 1.0), "bff_face": (0.0, -0.36, 0.93), "optcuts_face": (0.0, -1.0, 0.0)}  # and where their faces look
BLENDERS = ("ANGLE_BASED", "CONFORMAL", "MINIMUM_STRETCH")
PLAIN = {"min_shape": 0.0, "further_cuts": False}
SIZES = 10_000, 30_000, 100_000, 300_000


def parser() -> command_line.Parser:
    """All arguments of the benchmark."""
    made = parts.parser("unwrap.py", __doc__, PARTS)
    made.add_argument("--models", nargs="+", choices=list(FILES), default=list(FILES), help="meshes")
    made.add_argument("--data", type=Path, default=environment.ROOT.parent / "shared" / "data", help="the folder of the meshes")
    made.add_argument("--repeats", type=int, default=1, help="runs of each, of which the fastest counts")
    return made


def main(arguments: list[str], _line: command_line.ProgressLine) -> None:
    """Measure; raises FarfieldError when the input is bad."""
    parts.measure(parser().parse_args(arguments), PARTS)


def stretch(given) -> dict[str, Any]:
    """Stretch and time on every mesh, and of peers on those that are disks."""
    found = {}
    for name in given.models:
        item, target = opened(given.data, name)
        even = np.zeros(len(target.mesh.triangles))
        settings = UnwrapSettings(**PLAIN) if name in DISKS else UnwrapSettings()
        runs = [timed(target, even, settings) for _ in range(given.repeats)]
        ours, seconds = min(runs, key=lambda run: run[1])
        found[name] = {
            "triangles": len(even),
            "charts": ours.charts,
            "ours": figures_of(ours.measures, seconds),
            "stages": rounded(ours.seconds),
        }
        if name in DISKS:
            for method in BLENDERS:
                found[name][method.lower()] = by_blender(item, target, method, given.repeats)
            found[name]["xatlas"] = by_xatlas(target.mesh, given.repeats)
            theirs = found[name]["minimum_stretch"]
            found[name]["excess_over_blender"] = round((ours.measures.l2 - 1.0) / (theirs["l2"] - 1.0), 3)
            found[name]["bound"] = DISKS[name]
            found[name]["time_over_blender"] = round(seconds / theirs["seconds"], 2)
        print(name, json.dumps(found[name]), file=sys.stderr)
    return found


def barrier(given) -> dict[str, Any]:
    """L2 stretch with the bound on shape over that without it."""
    found = {}
    for name in [name for name in given.models if name in DISKS]:
        _, target = opened(given.data, name)
        even = np.zeros(len(target.mesh.triangles))
        without, _ = timed(target, even, UnwrapSettings(**PLAIN))
        for bound in (0.05, 0.1, 0.15):
            within, seconds = timed(target, even, UnwrapSettings(min_shape=bound, further_cuts=False))
            costs = round(within.measures.l2 / without.measures.l2, 4)
            found[f"{name} {bound}"] = {"l2_over_without": costs, **figures_of(within.measures, seconds)}
    return found


def importance_part(given) -> dict[str, Any]:
    """Density ratio of heads whose fronts should get four times the texels, and the stretch of these fronts."""
    found = {}
    for name in [name for name in given.models if name in HEADS]:
        _, target = opened(given.data, name)
        areas, normals = face_areas_and_normals(target.mesh.corners)
        front = importance.from_direction(normals, np.array(HEADS[name]))
        even, _ = timed(target, 0.0 * front, UnwrapSettings())
        given_more, seconds = timed(target, front, UnwrapSettings())
        found[name] = {
            "front_l2_before": front_l2(even, front, areas),
            "front_l2": front_l2(given_more, front, areas),
            **figures_of(given_more.measures, seconds),
        }
    return found


def front_l2(made: Unwrapped, front: np.ndarray, areas: np.ndarray) -> float:
    """L2 stretch of the front alone."""
    squares = 0.5 * (made.stretches.largest**2 + made.stretches.smallest**2)
    return round(float(np.sqrt((squares * areas)[front > 0.5].sum() / areas[front > 0.5].sum())), 4)


def cracks(given) -> dict[str, Any]:
    """The largest stretch on the bunny, a disk with holes: with L2 alone, with the bound on shape, and with that and further cuts."""
    item, target = opened(given.data, "stanford_bunny")
    even = np.zeros(len(target.mesh.triangles))
    ways = {"L2 alone": UnwrapSettings(**PLAIN)}
    ways |= {f"bound {bound}": UnwrapSettings(min_shape=bound, further_cuts=False) for bound in (0.05, 0.1, 0.15)}
    ways["bound 0.05 and further cuts"] = UnwrapSettings(min_shape=0.05)
    found = {}
    for way, settings in ways.items():
        made, seconds = timed(target, even, settings)
        found[way] = figures_of(made.measures, seconds)
    found["times_smaller"] = {way: round(found["L2 alone"]["linf"] / figures["linf"], 2) for way, figures in found.items()}
    found["Blender"] = by_blender(item, target, "MINIMUM_STRETCH", 1)
    return found


def growth(_given) -> dict[str, Any]:
    """Time by number of triangles of one surface, a bumpy dome."""
    found = {}
    for count in SIZES:
        mesh = dome(count)
        made, seconds = timed_mesh(mesh, np.zeros(len(mesh.triangles)), UnwrapSettings(**PLAIN))
        found[len(mesh.triangles)] = figures_of(made.measures, seconds)
        print(len(mesh.triangles), round(seconds, 2), file=sys.stderr)
    seconds = [figures["seconds"] for figures in found.values()]
    return {**found, "ten_to_hundred_thousand": round(seconds[2] / seconds[0], 1)}


def million(_given) -> dict[str, Any]:
    """A million triangles: time, memory, and the longest wait between two steps, after which Esc is answered."""
    mesh = dome(1_000_000)
    steps = unwrap(mesh, np.arange(len(mesh.triangles)), NO_SEAMS, np.zeros(len(mesh.triangles)), UnwrapSettings(), "million")
    longest, label, started = 0.0, "", time.perf_counter()
    before = started
    while True:
        try:
            step = next(steps)
        except StopIteration as finished:
            made = finished.value
            break
        now = time.perf_counter()
        if now - before > longest:
            longest, label = now - before, step.label
        before = now
    seconds = time.perf_counter() - started
    memory = round(command_line.peak_memory_mb(), 1)
    return {
        "longest_step": round(longest, 2),
        "before": label,
        "peak_memory_mb": memory,
        **figures_of(made.measures, seconds),
        "stages": rounded(made.seconds),
    }


NO_SEAMS = np.zeros((0, 2), int)
PARTS = {"stretch": stretch, "barrier": barrier, "importance": importance_part, "cracks": cracks, "growth": growth, "million": million}


def opened(data: Path, name: str) -> tuple[bpy.types.Object, uv_maps.UvTarget]:
    """The largest mesh of a file."""
    scene_files.open_scene((data / FILES[name]).absolute())
    item = max((each for each in bpy.context.scene.objects if each.type == "MESH"), key=lambda each: len(each.data.polygons))
    return item, uv_maps.take(item, None)


def timed(target: uv_maps.UvTarget, weight: np.ndarray, settings: UnwrapSettings) -> tuple[Unwrapped, float]:
    """A map of ours and the seconds that it took, measuring it left out."""
    started = time.perf_counter()
    made = finish(unwrap(target.mesh, target.polygons, target.seams, weight, settings, target.name))
    return made, time.perf_counter() - started - made.seconds["measure"]


def timed_mesh(mesh: TriangleMesh, weight: np.ndarray, settings: UnwrapSettings) -> tuple[Unwrapped, float]:
    """As `timed`, of arrays."""
    started = time.perf_counter()
    made = finish(unwrap(mesh, np.arange(len(mesh.triangles)), NO_SEAMS, weight, settings))
    return made, time.perf_counter() - started - made.seconds["measure"]


def by_blender(item: bpy.types.Object, target: uv_maps.UvTarget, method: str, repeats: int) -> dict[str, Any]:
    """The map that one of Blender's methods makes."""
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    layer = item.data.uv_layers.get("peer") or item.data.uv_layers.new(name="peer")
    item.data.uv_layers.active = layer
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    best = np.inf
    for _ in range(repeats):
        started = time.perf_counter()
        bpy.ops.uv.unwrap(method=method, margin=0.0, fill_holes=False, correct_aspect=False)
        best = min(best, time.perf_counter() - started)
    bpy.ops.object.mode_set(mode="OBJECT")
    uvs = uv_maps.uvs_of(item.data.uv_layers["peer"])
    return figures_of(measures_of(target.mesh, uvs[target.loops].astype(np.float64)), best)


def by_xatlas(mesh: TriangleMesh, repeats: int) -> dict[str, Any]:
    """The map that xatlas makes, in as many charts as it likes."""
    import xatlas

    best = np.inf
    for _ in range(repeats):
        started = time.perf_counter()
        atlas = xatlas.Atlas()
        atlas.add_mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
        atlas.generate()
        best = min(best, time.perf_counter() - started)
    _, triangles, uvs = atlas.get_mesh(0)
    placed = uvs[triangles].astype(np.float64) * [atlas.width, atlas.height] / max(atlas.width, atlas.height)
    return {**figures_of(measures_of(mesh, placed), best), "charts": atlas.chart_count}


def measures_of(mesh: TriangleMesh, corners: np.ndarray) -> Measures:
    """The figures of a map `corners` (T, 3, 2) in which nothing matters more than the rest."""
    return finish(measured(mesh, corners, finish(stretches_of(mesh, corners)), np.zeros(len(corners))))


def figures_of(measures: Measures, seconds: float) -> dict[str, Any]:
    """Figures rounded for reading; None where a map has collapsed triangles, whose stretch has no end."""
    names = ("l2", "linf", "p95", "p99", "symmetric_dirichlet", "flips", "overlaps", "min_shape", "fill", "density_ratio")
    found = {name: getattr(measures, name) for name in names}
    return {**{name: round(value, 4) if np.isfinite(value) else None for name, value in found.items()}, "seconds": round(seconds, 2)}


def rounded(seconds: dict[str, float]) -> dict[str, float]:
    """Seconds by stage."""
    return {stage: round(taken, 2) for stage, taken in seconds.items()}


def dome(count: int) -> TriangleMesh:
    """About `count` triangles of a bumpy dome that covers three quarters of a ball: a disk."""
    side = int(np.sqrt(count / 2))
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, side + 1), np.linspace(-1.0, 1.0, side + 1), indexing="ij")
    far = np.maximum(np.abs(u), np.abs(v))
    length = np.hypot(u, v)
    polar = far * 0.66 * np.pi
    radius = 1.0 + 0.05 * np.sin(7.0 * u) * np.sin(5.0 * v) + 0.01 * np.sin(31.0 * u + 1.0) * np.sin(29.0 * v)
    unit = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    vertices = radius[..., None] * np.stack([np.sin(polar) * u * unit, np.sin(polar) * v * unit, np.cos(polar)], axis=-1)
    row, column = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    a = (row * (side + 1) + column).ravel()
    b, c, d = a + side + 1, a + side + 2, a + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return TriangleMesh(vertices.reshape(-1, 3), triangles.astype(np.int32))


if __name__ == "__main__":
    command_line.run(main)
