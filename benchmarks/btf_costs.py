"""Cost of relightable textures: time relative to the Cycles renders alone, comparison of executors, memory."""

import math
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from btf_bakes import BenchmarkCloud, BenchmarkOptions, bake, build_cloud

from farfield.addon.core.jobs.progress import Progress, Steps
from lib import environment

sys.path.append(str(environment.ROOT / "tests"))

from dask_farm import DaskFarm

PROCESSES = 2
TWO_PROCESSES = f"processes:{PROCESSES}"
EXECUTORS = {"serial": 1, TWO_PROCESSES: PROCESSES, "dask": PROCESSES}  # number of simultaneous workers
MEMORY_MODEL, MEMORY_ERROR = "leafy_tree", 0.03
MEMORY_TEXELS, MEMORY_SIDE = 60_000, 8  # 64 views x (64 lights and a dome)


def measure_times(options: BenchmarkOptions) -> Steps[dict[str, Any]]:
    """Time complete bakes of the first model with each executor in turn; the best of the repeats counts."""
    cloud = build_cloud(options.models[0], options, options.error)
    runs: dict[str, list[dict[str, Any]]] = {}
    skipped = []
    for repeat in range(options.repeats):
        for index, name in enumerate(options.executors):
            yield Progress((repeat + index / len(options.executors)) / options.repeats, f"Baking {options.models[0]}: {name}")
            with _open_executor(name) as spec:
                if spec is None:
                    skipped = ["Dask: the package distributed is not installed for this Python."]
                    continue
                runs.setdefault(name, []).append(_time_bake(cloud, spec, EXECUTORS[name], options))
    best = {name: min(executor_runs, key=lambda run: run["capture_seconds"]) for name, executor_runs in runs.items()}
    figures = {"model": options.models[0], "texels": cloud.report["texels"], "best": best, "runs": runs, "skipped": skipped}
    for reason in skipped:
        print(f"Skipped: {reason}", file=sys.stderr)
    if {"dask", TWO_PROCESSES} <= set(best):
        ratio = best["dask"]["capture_seconds"] / best[TWO_PROCESSES]["capture_seconds"]
        figures["dask_over_processes"] = round(ratio, 3)
    return figures


def measure_memory(options: BenchmarkOptions) -> Steps[dict[str, Any]]:
    """Measure the peak memory of a bake of at least 60,000 texels with 4,160 renders, one sample per pixel, in two processes."""
    error = MEMORY_ERROR
    yield Progress(0.0, "Building clouds")
    cloud = build_cloud(MEMORY_MODEL, options, f"{100.0 * error:.2f}%")
    while cloud.report["texels"] < MEMORY_TEXELS:
        error *= math.sqrt(cloud.report["texels"] / MEMORY_TEXELS) * 0.99
        cloud = build_cloud(MEMORY_MODEL, options, f"{100.0 * error:.2f}%")
    yield Progress(0.1, "Baking")
    grid = {"views_per_side": MEMORY_SIDE, "lights_per_side": MEMORY_SIDE, "capture_samples": 1}
    report = bake(cloud, "memory", cloud.path.with_name("views of memory"), replace(options, **grid), "--executor", TWO_PROCESSES)
    return {"texels": cloud.report["texels"], **{key: report[key] for key in ("renders", "peak_memory_mb", "workers_peak_memory_mb")}}


def _time_bake(cloud: BenchmarkCloud, spec: str, slots: int, options: BenchmarkOptions) -> dict[str, Any]:
    """Time a complete bake with `slots` workers. `..._over_bare`: wall time of the capture or script over the Cycles time per worker."""
    work = Path(tempfile.mkdtemp(prefix="bake-", dir=cloud.path.parent))
    try:
        report = bake(cloud, "timed", work, options, "--executor", spec)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    render_seconds = report["bare_render_seconds"] / slots
    capture = report["seconds"]["capture"]
    return {
        "renders": report["renders"],
        "bare_render_seconds": report["bare_render_seconds"],
        "capture_seconds": round(capture, 1),
        "wall_seconds": report["wall_seconds"],
        "seconds": report["seconds"],
        "capture_over_bare": round(capture / render_seconds, 3),
        "wall_over_bare": round(report["wall_seconds"] / render_seconds, 3),
    }


@contextmanager
def _open_executor(name: str) -> Iterator[str | None]:
    """Yield an executor spec. For Dask, start a scheduler and workers for the duration of the block; None if Dask is not installed."""
    if name != "dask":
        yield name
        return
    try:
        import distributed  # noqa: F401 - only checks whether it is installed
    except ImportError:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="farfield-dask-", ignore_cleanup_errors=True) as folder:
        farm = DaskFarm(Path(folder))
        try:
            farm.start_workers(PROCESSES)
            yield f"dask:{farm.address}"
        finally:
            farm.close()
