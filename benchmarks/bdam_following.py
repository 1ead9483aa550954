"""What a terrain costs while it follows a viewer, for `bench_bdam.py`: the engine's moves, and the main thread's slices."""

import time
from argparse import Namespace
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from bdam_measured import summarize
from bdam_stores import Workplace, build_fractal
from bdam_terrains import CELL_SIZE, FractalTerrain
from bdam_views import FLIGHT_CLEARANCE, FLIGHT_PITCH, look, perspective

from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.geometry.viewers import Viewer
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.bdam.job import ShowJob
from farfield.addon.operators.following import Following

SIZE, MOVES, STEP = 1025, 60, 120.0  # samples per side; meters
DECODED = 64  # patches at once
TICK = 1.0 / 60.0  # seconds
SLICE_BOUNDS = {"median_ms": 8.0, "95th_ms": 16.0}
SETTINGS = ViewSettings(shading="slope")


def measure_following(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure the CPU time of patches, of the first view and of moves without prefetching, and slices of the main thread."""
    terrain = FractalTerrain(SIZE, given.seed)
    with build_fractal(workplace, terrain) as store:
        viewers, folder = list(_fly(terrain, store)), store.folder
        keys = [(level, row) for level, patches in enumerate(store.levels) for row in range(len(patches.indices))]
        decode_seconds = cpu_seconds(lambda: [store.read_all(keys[start : start + DECODED]) for start in range(0, len(keys), DECODED)])
    engine = BdamEngine(folder, SETTINGS)
    first, *moves = [cpu_seconds(lambda viewer=viewer: run_to_end(engine.move(viewer))) for viewer in viewers]
    return {
        "ms_per_patch": round(1e3 * decode_seconds / len(keys), 3),
        "first_view_cpu_seconds": round(first, 3),
        "move_cpu_ms": summarize([1e3 * seconds for seconds in moves]),
        "slices": _follow(BdamEngine(folder, SETTINGS), viewers),
        "slice_bounds": SLICE_BOUNDS,
    }


def _fly(terrain: FractalTerrain, store: TerrainStore) -> list[Viewer]:
    """Return viewers that go east in steps."""
    row, columns = terrain.size // 2, 100.0 + STEP / CELL_SIZE * np.arange(MOVES)
    ground = terrain.read(slice(row, row + 1))[0]
    x, y = store.frame.to_local(columns, np.full(MOVES, float(row)))
    heights = [float(ground[int(column) - 50 : int(column) + 51].max()) + FLIGHT_CLEARANCE for column in columns]
    return [look(np.array(position), 0.0, FLIGHT_PITCH, perspective()) for position in zip(x, y, heights, strict=True)]


def _follow(engine: BdamEngine, viewers: list[Viewer]) -> dict[str, Any]:
    """Follow viewers as the timer of Blender does; return milliseconds of ticks that do something, and the CPU time of their thread."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    job = ShowJob(engine, viewers[0], str(engine.folder))
    run_to_end(job.scene_steps(run_to_end(job.core_steps())))
    following, wall, cpu = Following(job.terrain), [], []
    for viewer in viewers[1:]:
        while not following.is_settled(viewer):
            moves, started, cpu_started = following.moves, time.perf_counter(), time.thread_time()
            following.tick(viewer)
            wall.append(1e3 * (time.perf_counter() - started))
            cpu.append(1e3 * (time.thread_time() - cpu_started))
            time.sleep(max(0.0, TICK - (time.perf_counter() - started)))
            if following.moves > moves:
                break
    following.close()
    works = [index for index, milliseconds in enumerate(cpu) if milliseconds > 0.2]
    return {"ms": summarize([wall[index] for index in works]), "cpu_ms": summarize([cpu[index] for index in works])}


def cpu_seconds(work: Callable[[], Any]) -> float:
    """Return the CPU seconds of this process that something takes."""
    started = time.process_time()
    work()
    return time.process_time() - started
