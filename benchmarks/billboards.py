"""What billboard clouds cost and how good they are: `python3 benchmarks/billboards.py [--only PART ...] [--sheets DIR] [--report R.json]`.

Prints JSON. Parts: `table` (Table 1 of the paper, each error on its own, and one nested run), `time` (seconds and growth), `rounds`
(merging in rounds against one pair at a time), `pictures` (likeness at the switch size), `memory` (a process of its own). The meshes are
those beside the project, in ../shared/data; without them there is nothing to measure.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

import environment

environment.ensure()

import bpy
import numpy as np
from one_at_a_time import merge_one_at_a_time, texture_waste

import billboards
import command_line
import scene_files
from comparison import compare, sheet
from contact_sheet import write_png
from farfield.addon.bridge.meshes import take
from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.hierarchy import ClusterBounds, merge_in_rounds
from farfield.addon.core.billboards.primitives import from_mesh
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import FileError
from farfield.addon.core.mesh import TriangleMesh, longest_side
from farfield.addon.core.progress import Progress, finish
from farfield.addon.core.spatial import neighbour_pairs
from farfield.addon.operators.billboards_job import BuildOptions
from farfield.addon.operators.long_work import whole

DATA = environment.ROOT.parent / "shared" / "data"
HEAD, BUNNY, TREE = DATA / "meshes" / "max_planck.obj", DATA / "meshes" / "stanford_bunny.obj", DATA / "trees" / "leafy_tree.glb"
ERRORS = (0.04, 0.02, 0.01, 0.005)
PAPER = {  # Table 1, Max Planck head: quads and texels by error; None where the table cannot be read
    "clusters": ((60, 6.9e3), (93, 26e3), (193, 112e3), (478, 432e3)),
    "decimate": ((66, 4e3), (168, 17e3), (195, 70e3), (404, 280e3)),
    "hough": ((34, 30e3), (None, 175e3), (164, 1.6e6), (434, 14e6)),
}
REPEATS = 3
LARGE_TRIANGLES = 200_000
PAIRWISE_TRIANGLES = 1_500  # one pair at a time takes minutes for more


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Measure, and print one JSON object; raises FileError when the meshes are not there."""
    parser = command_line.Parser(prog="billboards.py", description="Measure billboard clouds.")
    parser.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS), help="the parts to measure (default: all)")
    parser.add_argument("--sheets", type=Path, help="a folder for the contact sheets of the part pictures")
    parser.add_argument("--report", type=Path, help="a JSON file for the figures")
    given = parser.parse_args(arguments)
    if not HEAD.exists():
        raise FileError(f'The meshes to measure with are not in "{DATA}"; this benchmark needs them.')
    figures = {}
    for number, part in enumerate(given.only):
        line.show(Progress(number / len(given.only), f"Measuring {part}"))
        figures[part] = PARTS[part](given.sheets)
    line.clear()
    print(json.dumps(figures, indent=2))
    if given.report is not None:
        command_line.write_report(given.report.absolute(), figures)


def table(_sheets: Path | None) -> dict[str, Any]:
    """Quads and texels of the head by method and error, beside the paper's; and all four errors as the levels of one cloud."""
    head = read(HEAD)
    rows: dict[str, Any] = {}
    for method, peers in PAPER.items():
        rows[method] = [
            {**row(built(head, method=method, error=error, levels=1)), "paper_quads": quads, "paper_texels": texels}
            for error, (quads, texels) in zip(ERRORS, peers, strict=True)
        ]
    nested = built(head, error=ERRORS[-1], levels=len(ERRORS))
    rows["clusters_nested"] = [
        {"error": level.error / nested.longest_side, "quads": len(level.quads), "texels": level.texels} for level in reversed(nested.levels)
    ]
    return rows


def row(cloud: Cloud) -> dict[str, Any]:
    """The figures of a cloud of one level."""
    level = cloud.levels[0]
    return {
        "error": level.error / cloud.longest_side,
        "quads": len(level.quads),
        "texels": level.texels,
        "max_plane_distance": cloud.max_plane_distance,
        "faces_beyond_normal_bound": cloud.faces_beyond_normal_bound,
        "uncovered_faces": cloud.uncovered_faces,
        "seconds": round(sum(cloud.seconds.values()), 2),
    }


def times(_sheets: Path | None) -> dict[str, Any]:
    """Wall seconds of clustering at 1 %, best of a few runs in turn, with one level and with three; and growth with size."""
    meshes = {"max_planck": read(HEAD), "leafy_tree": read(TREE), "bunny": read(BUNNY)}
    best: dict[str, float] = {}
    for _ in range(REPEATS):
        for name, mesh in meshes.items():
            for levels in (1, 3):
                start = time.perf_counter()
                built(mesh, error=0.01, levels=levels)
                key = f"{name}_{levels}_levels"
                best[key] = min(best.get(key, np.inf), round(time.perf_counter() - start, 2))
    growth = {levels: best[f"bunny_{levels}_levels"] / best[f"max_planck_{levels}_levels"] for levels in (1, 3)}
    return {"seconds": best, **{f"growth_{levels}_levels": round(ratio, 2) for levels, ratio in growth.items()}}


def rounds(_sheets: Path | None) -> dict[str, Any]:
    """Clusters and texture waste of merging in rounds of mutual best pairs, and of one pair at a time, on a part of the head."""
    head = read(HEAD)
    low = head.vertices[head.triangles].mean(axis=1)
    chosen = np.argsort(low[:, 0], kind="stable")[:PAIRWISE_TRIANGLES]
    primitives = from_mesh(TriangleMesh(head.vertices, head.triangles[chosen]))
    pairs, distances = neighbour_pairs(primitives.positions, 50)
    side = longest_side(head.vertices)
    rows = []
    for error in ERRORS:
        bounds = ClusterBounds(error * side, np.radians(60.0), 8.0)
        start = np.arange(len(primitives), dtype=np.int32)
        in_rounds = finish(merge_in_rounds(primitives, start, pairs, distances, bounds, 0))
        one_by_one = merge_one_at_a_time(primitives, pairs, bounds, 0)
        row = {"error": error}
        for name, labels in (("rounds", in_rounds), ("pairs", one_by_one)):
            row[name] = {"clusters": int(labels.max()) + 1, "waste": round(texture_waste(primitives, labels), 3)}
        rows.append(row)
    return {"triangles": len(primitives), "rows": rows}


def pictures(sheets: Path | None) -> dict[str, Any]:
    """Likeness of the finest level at the switch size from twelve held-out views, at 1 %."""
    likeness = {}
    for path in (HEAD, TREE):
        scene_files.open_scene(path)
        job = billboards.prepare_input(BillboardSettings(error=0.01, levels=1), BuildOptions(together=True))
        finish(whole(job))
        cloud = billboards.standing(job)[0]
        comparison = finish(compare(cloud.sources, cloud.levels[0]))
        likeness[path.stem] = comparison.figures()
        if sheets is not None:
            sheets.mkdir(parents=True, exist_ok=True)
            write_png(sheets / f"{path.stem}.png", sheet(path.stem, comparison))
    return likeness


def memory(_sheets: Path | None) -> dict[str, Any]:
    """Peak memory of the batch script on a knobbly ball of about 200,000 triangles, textures and all."""
    rows = round(np.sqrt(LARGE_TRIANGLES / 2.0))
    turn, rise = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, rows, endpoint=False), np.linspace(1e-3, np.pi - 1e-3, rows + 1))
    radius = 1.0 + 0.05 * np.sin(7.0 * turn) * np.sin(9.0 * rise)
    points = radius[..., None] * np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)], axis=2)
    first = np.arange(rows * rows).reshape(rows, rows)
    beside = np.roll(first, -1, axis=1)
    quads = np.stack([first, first + rows, beside + rows, beside], axis=2).reshape(-1, 4)
    with tempfile.TemporaryDirectory() as folder:
        source, report = Path(folder) / "ball.obj", Path(folder) / "report.json"
        with source.open("w", encoding="utf-8") as file:
            np.savetxt(file, points.reshape(-1, 3), "v %.7f %.7f %.7f")
            np.savetxt(file, quads + 1, "f %d %d %d %d")
        script = environment.ROOT / "scripts" / "billboards.py"
        command = [sys.executable, script, source, "--out", Path(folder) / "ball.blend", "--report", report]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        figures = json.loads(report.read_text(encoding="utf-8"))
    return {name: figures[name] for name in ("source_triangles", "quads", "texels", "seconds", "peak_memory_mb")}


def read(path: Path) -> TriangleMesh:
    """All surfaces of a file as one mesh in world space."""
    scene_files.open_scene(path)
    return take([item for item in bpy.context.scene.objects if item.type == "MESH"], bpy.context.evaluated_depsgraph_get()).mesh


def built(mesh: TriangleMesh, method: str = "clusters", error: float = 0.01, levels: int = 1) -> Cloud:
    """The cloud of `mesh`, without textures."""
    return finish(build(mesh, BillboardSettings(method=method, error=error, levels=levels)))


PARTS: dict[str, Callable[[Path | None], dict[str, Any]]] = {
    "table": table,
    "time": times,
    "rounds": rounds,
    "pictures": pictures,
    "memory": memory,
}

if __name__ == "__main__":
    command_line.run(main)
