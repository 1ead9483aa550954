"""Benchmark of the cost and quality of billboard clouds: `python3 benchmarks/bench_billboards.py [--only PART ...] [--report R.json]`.

Prints JSON. Parts: `table` (Table 1 of the paper, separately per error, and one nested run), `time` (seconds and growth), `rounds` (merging
in rounds compared with one pair at a time), `images` (comparison at the switch distance), `memory` (in a separate process), `ordinary`
(billboards_ordinary.py: ordinary models compared with Decimate and octahedral impostors, from other views in each run). The meshes are in
../shared/data next to the checkout and are required.
"""

import json
import secrets
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
from billboards_ordinary import MODELS, measure_ordinary
from greedy_clustering import merge_one_at_a_time, texture_waste

import billboards
from farfield.addon.bridge.geometry.meshes import read_source
from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.clustering.hierarchy import ClusterBounds, merge_in_rounds
from farfield.addon.core.billboards.primitives import from_mesh
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions
from farfield.addon.core.errors import FileError
from farfield.addon.core.geometry.mesh import TriangleMesh, longest_side
from farfield.addon.core.geometry.proximity import neighbor_pairs
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.job_run import run_job
from lib import command_line, scene_files
from lib.comparison import compare_cloud, draw_comparison_sheet
from lib.contact_sheet import write_png

DATA = environment.ROOT.parent / "shared" / "data"
HEAD, BUNNY, TREE = DATA / "meshes" / "max_planck.obj", DATA / "meshes" / "stanford_bunny.obj", DATA / "trees" / "leafy_tree.glb"
ERRORS = (0.04, 0.02, 0.01, 0.005)
PAPER_TABLE = {  # Table 1, Max Planck head: quads and texels per error; None if illegible
    "clusters": ((60, 6.9e3), (93, 26e3), (193, 112e3), (478, 432e3)),
    "decimate": ((66, 4e3), (168, 17e3), (195, 70e3), (404, 280e3)),
    "hough": ((34, 30e3), (None, 175e3), (164, 1.6e6), (434, 14e6)),
}
REPEATS = 3
LARGE_TRIANGLES = 200_000
PAIRWISE_TRIANGLES = 1_500  # one pair at a time takes minutes for more


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Run the selected parts and return one JSON object. Raises FileError if the meshes are missing."""
    parser = benchmark_cli.build_parser("bench_billboards.py", __doc__, PARTS)
    parser.add_argument("--sheets", type=Path, help="folder for the contact sheets of the parts `images` and `ordinary`")
    parser.add_argument("--models", nargs="+", choices=MODELS, help="models of the part `ordinary`; by default all")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6), help="of generated models and views of the part `ordinary`")
    parser.add_argument("--impostors", action="store_true", help="also compare with octahedral impostors, which takes minutes per level")
    given = parser.parse_args(arguments)
    if not HEAD.exists():
        raise FileError(f'The folder "{DATA}" does not contain the meshes of this benchmark.')
    print(f"seed {given.seed}", file=sys.stderr)
    return benchmark_cli.run_parts(given, PARTS)


def measure_table(_given: Namespace) -> dict[str, Any]:
    """Measure quads and texels of the head per method and error, compared with the paper, and all four errors as levels of one cloud."""
    head = read_mesh(HEAD)
    rows: dict[str, Any] = {}
    for method, published in PAPER_TABLE.items():
        rows[method] = [
            {**make_row(build_untextured(head, method=method, error=error, levels=1)), "paper_quads": quads, "paper_texels": texels}
            for error, (quads, texels) in zip(ERRORS, published, strict=True)
        ]
    nested = build_untextured(head, error=ERRORS[-1], levels=len(ERRORS), nested_levels=True)
    rows["clusters_nested"] = [
        {"error": level.error / nested.longest_side, "quads": len(level.quads), "texels": level.texel_count}
        for level in reversed(nested.levels)
    ]
    return rows


def make_row(cloud: Cloud) -> dict[str, Any]:
    """Return the measurements of a cloud of one level."""
    level = cloud.levels[0]
    return {
        "error": level.error / cloud.longest_side,
        "quads": len(level.quads),
        "texels": level.texel_count,
        "max_plane_distance": cloud.max_plane_distance,
        "faces_beyond_normal_bound": cloud.faces_beyond_normal_bound,
        "uncovered_faces": cloud.uncovered_faces,
        "seconds": round(sum(cloud.seconds.values()), 2),
    }


def measure_time(_given: Namespace) -> dict[str, Any]:
    """Measure the wall seconds of clustering at 1 %, best of several runs, with one level and with three, and the growth with size."""
    meshes = {"max_planck": read_mesh(HEAD), "leafy_tree": read_mesh(TREE), "bunny": read_mesh(BUNNY)}
    best: dict[str, float] = {}
    for _ in range(REPEATS):
        for name, mesh in meshes.items():
            for levels in (1, 3):
                start = time.perf_counter()
                build_untextured(mesh, error=0.01, levels=levels)
                key = f"{name}_{levels}_levels"
                best[key] = min(best.get(key, np.inf), round(time.perf_counter() - start, 2))
    growth = {levels: best[f"bunny_{levels}_levels"] / best[f"max_planck_{levels}_levels"] for levels in (1, 3)}
    return {"seconds": best, **{f"growth_{levels}_levels": round(ratio, 2) for levels, ratio in growth.items()}}


def measure_rounds(_given: Namespace) -> dict[str, Any]:
    """Compare merging in rounds of mutual best pairs with one pair at a time: clusters and texture waste on a part of the head."""
    head = read_mesh(HEAD)
    centroids = head.vertices[head.triangles].mean(axis=1)
    chosen = np.argsort(centroids[:, 0], kind="stable")[:PAIRWISE_TRIANGLES]
    primitives = from_mesh(TriangleMesh(head.vertices, head.triangles[chosen]))
    pairs, distances = neighbor_pairs(primitives.positions, 50)
    side = longest_side(head.vertices)
    rows = []
    for error in ERRORS:
        bounds = ClusterBounds(error * side, np.radians(60.0), 8.0)
        groups = np.arange(len(primitives), dtype=np.int32)
        in_rounds = run_to_end(merge_in_rounds(primitives, groups, pairs, distances, bounds, 0))
        one_by_one = merge_one_at_a_time(primitives, pairs, bounds, 0)
        row = {"error": error}
        for name, labels in (("rounds", in_rounds), ("pairs", one_by_one)):
            row[name] = {"clusters": int(labels.max()) + 1, "waste": round(texture_waste(primitives, labels), 3)}
        rows.append(row)
    return {"triangles": len(primitives), "rows": rows}


def measure_images(given: Namespace) -> dict[str, Any]:
    """Compare images of the finest level at the switch distance with the source, from twelve held-out views, at 1 %."""
    reports = {}
    for path in (HEAD, TREE):
        scene_files.open_scene(path)
        options = BuildOptions(combine_selected=True, keep_original_visible=True)
        job = billboards.prepare_input(path, BillboardSettings(error=0.01, levels=1), options)
        run_to_end(run_job(job))
        cloud = billboards.read_built_clouds(job)[0]
        comparison = run_to_end(compare_cloud(cloud.sources, cloud.levels[0]))
        reports[path.stem] = comparison.to_report()
        if given.sheets is not None:
            given.sheets.mkdir(parents=True, exist_ok=True)
            write_png(given.sheets / f"{path.stem}.png", draw_comparison_sheet(path.stem, comparison))
    return reports


def measure_memory(_given: Namespace) -> dict[str, Any]:
    """Measure the peak memory of the script on a bumpy ball of about 200,000 triangles, including textures."""
    rows = round(np.sqrt(LARGE_TRIANGLES / 2.0))
    azimuth, polar = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, rows, endpoint=False), np.linspace(1e-3, np.pi - 1e-3, rows + 1))
    radius = 1.0 + 0.05 * np.sin(7.0 * azimuth) * np.sin(9.0 * polar)
    points = radius[..., None] * np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=2)
    first = np.arange(rows * rows).reshape(rows, rows)
    following = np.roll(first, -1, axis=1)
    quads = np.stack([first, first + rows, following + rows, following], axis=2).reshape(-1, 4)
    with tempfile.TemporaryDirectory() as folder:
        source, report = Path(folder) / "ball.obj", Path(folder) / "report.json"
        with source.open("w", encoding="utf-8") as file:
            np.savetxt(file, points.reshape(-1, 3), "v %.7f %.7f %.7f")
            np.savetxt(file, quads + 1, "f %d %d %d %d")
        script = environment.ROOT / "scripts" / "billboards.py"
        command = [sys.executable, script, source, "--out", Path(folder) / "ball.blend", "--report", report]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        results = json.loads(report.read_text(encoding="utf-8"))
    return {name: results[name] for name in ("source_triangles", "quads", "texels", "seconds", "peak_memory_mb")}


def read_mesh(path: Path) -> TriangleMesh:
    """Read all surfaces of a file as one mesh in world space."""
    scene_files.open_scene(path)
    return read_source([item for item in bpy.context.scene.objects if item.type == "MESH"], bpy.context.evaluated_depsgraph_get()).mesh


def build_untextured(mesh: TriangleMesh, **settings: Any) -> Cloud:
    """Build the cloud of `mesh` without textures."""
    return run_to_end(build_cloud(mesh, BillboardSettings(**({"solid_parts": "quads"} | settings))))


PARTS = {
    "table": measure_table,
    "time": measure_time,
    "rounds": measure_rounds,
    "images": measure_images,
    "memory": measure_memory,
    "ordinary": measure_ordinary,
}

if __name__ == "__main__":
    command_line.run(main)
