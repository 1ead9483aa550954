"""Work that `bench_bdam.py` measures in a process of its own, or kills: `python3 benchmarks/bdam_measured.py WORK ...`.

Prints the figures as JSON. Memory is the peak above that of the process after its imports, which contain bpy.
"""

import json
import sys
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import numpy as np
from bdam_renders import render_view
from bdam_stores import cpu_seconds
from bdam_terrains import CELL_SIZE, FractalTerrain
from bdam_views import fly_over

from farfield.addon.core.bdam.building.erosion import erode_heights
from farfield.addon.core.bdam.building.height_grid import HeightGrid
from farfield.addon.core.bdam.building.heights import choose_height_step, write_heights
from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, open_field
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.extraction import CutSettings, extract_cut
from farfield.addon.core.bdam.view.tiles import TileGrouping, build_tile_mesh
from farfield.addon.core.jobs.progress import run_to_end
from lib import command_line, run_files


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Do the work; returns the measurements as JSON."""
    parser = command_line.Parser(prog="bdam_measured.py", description="Work that bench_bdam.py measures.")
    parser.add_argument("work", choices=list(WORK))
    parser.add_argument("path", type=run_files.parse_path, help="an elevation model, or a store")
    parser.add_argument("--out", type=run_files.parse_path, help="the store to build, or the picture")
    parser.add_argument("--tolerance", type=float, default=1.0, help="pixels, of the cut that is rendered; 0 for all samples")
    parser.add_argument("--render-seed", type=int, default=0, help="of the noise of the render")
    parser.add_argument("--normal-maps", action="store_true", help="render with the normal maps of the store")
    parser.add_argument("--image", type=run_files.parse_path, help="the texture of the build")
    parser.add_argument("--executor", default="processes", help="of the build")
    parser.add_argument("--size", type=int, default=0, help="samples per side of the terrain that is flown over")
    parser.add_argument("--seed", type=int, default=0, help="of that terrain")
    given = parser.parse_args(arguments)
    before, started, cpu = memory_mb("VmRSS"), time.perf_counter(), cpu_seconds()
    figures = WORK[given.work](given)
    costs = {"seconds": round(time.perf_counter() - started, 2), "cpu_seconds": round(cpu_seconds() - cpu, 2)}
    memory = {"peak_memory_above_imports_mb": round(memory_mb("VmHWM") - before, 1), "imports_mb": round(before, 1)}
    return json.dumps(costs | memory | figures)


def build(given: Namespace) -> dict[str, Any]:
    """Build the store of an elevation model, with the texture of an image if there is one."""
    terrain = open_field([given.path], FieldSettings(cell_size=CELL_SIZE))
    images = [] if given.image is None else [given.image]
    settings = BdamSettings(executor=given.executor, cell_size=CELL_SIZE)
    report = run_to_end(build_terrain(terrain, [given.path], given.out, settings, images))
    stages = {stage: round(seconds, 2) for stage, seconds in report.seconds.items()}
    return {"stages": stages, "tiles": report.tiles, "triangles": report.triangles}


def fly(given: Namespace) -> dict[str, Any]:
    """Extract the cuts of a fly-over, and build the meshes of the tiles that change, as the engine does. All that are shown are kept."""
    figures: dict[str, Any] = {}
    with TerrainStore(given.path) as store:
        viewers = list(fly_over(FractalTerrain(given.size, given.seed), store))
        for culls in (False, True):
            settings, cache = CutSettings(culls=culls), PatchCache(store)
            grouping, shown = TileGrouping(store), {}
            seconds, patches, triangles, tiles, mesh_seconds = [], [], [], [], []
            for viewer in viewers:
                started = time.perf_counter()
                cut = extract_cut(store, viewer, settings)
                seconds.append(time.perf_counter() - started)
                started = time.perf_counter()
                wanted = grouping.group(cut, {(0, 0, 0): None})
                shown = {key: value for key, value in shown.items() if key in wanted and value[0] == wanted[key].signature}
                for key in wanted.keys() - shown.keys():
                    shown[key] = wanted[key].signature, build_tile_mesh(store, cache, key, wanted[key], settings.exaggeration)
                mesh_seconds.append(time.perf_counter() - started)
                patches.append(len(cut))
                triangles.append(int(cut.count_triangles(store).sum()))
                tiles.append(len(wanted))
            figures["culled" if culls else "everywhere"] = {
                "extraction_ms": summarize([1e3 * value for value in seconds]),
                "tile_meshes_ms": summarize([1e3 * value for value in mesh_seconds]),
                "patches": summarize(patches),
                "triangles": summarize(triangles),
                "tiles": summarize(tiles),
            }
    return {"frames": len(viewers)} | figures


def summarize(values: list[float]) -> dict[str, float]:
    """Return the mean, the median, the 95th percentile and the largest of values."""
    return {
        "mean": round(float(np.mean(values)), 2),
        "median": round(float(np.median(values)), 2),
        "95th": round(float(np.percentile(values, 95.0)), 2),
        "max": round(float(np.max(values)), 2),
    }


def memory_mb(name: str) -> float:
    """Return the resident memory (VmRSS) or its peak (VmHWM) of this process in MB (10^6 bytes).

    Where the system does not tell them apart, both are the peak.
    """
    status = Path("/proc/self/status")
    if not status.is_file():
        return command_line.peak_memory_mb()
    values = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines() if ":" in line)
    return int(values[name].split()[0]) * 1024 / 1e6


def render(given: Namespace) -> dict[str, Any]:
    """Render a frame of the fly-over."""
    return render_view(given.path, given.out, given.tolerance, FractalTerrain(given.size, given.seed), given.render_seed, given.normal_maps)


def erode(given: Namespace) -> dict[str, Any]:
    """Erode an elevation model. The heights before and after are files next to `given.out`."""
    terrain = open_field([given.path], FieldSettings(cell_size=CELL_SIZE))
    source, height_step = HeightGrid(given.out.with_suffix(".source"), *terrain.shape), choose_height_step(terrain, 0.0, is_eroded=True)
    run_to_end(write_heights(terrain, source.path, height_step))
    started, cpu = time.perf_counter(), cpu_seconds()
    run_to_end(erode_heights(source, given.out, CELL_SIZE / height_step, 1.0))
    return {"erosion_seconds": round(time.perf_counter() - started, 2), "erosion_cpu_seconds": round(cpu_seconds() - cpu, 2)}


WORK = {"build": build, "erode": erode, "fly": fly, "render": render}

if __name__ == "__main__":
    command_line.run(main)
