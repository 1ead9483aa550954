"""What relightable textures cost: time against bare Cycles, executors against each other, memory."""

import math
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from btf_bakes import Cloud, Effort, baked, built_cloud

import environment
from farfield.addon.core.progress import Progress, Steps

sys.path.append(str(environment.ROOT / "tests"))

from dask_farm import Farm

PROCESSES = 2
SPREAD = f"processes:{PROCESSES}"
EXECUTORS = {"serial": 1, SPREAD: PROCESSES, "dask": PROCESSES}  # how many work at a time
MEMORY_MODEL, MEMORY_ERROR = "leafy_tree", 0.03
MEMORY_TEXELS, MEMORY_SIDE = 60_000, 8  # 64 views x (64 lights and a dome)


def times(effort: Effort) -> Steps[dict[str, Any]]:
    """Bakes of the first model from nothing with each executor in turn; best of the repeats."""
    cloud = built_cloud(effort.models[0], effort, effort.error)
    runs: dict[str, list[dict[str, Any]]] = {}
    left_out = []
    for repeat in range(effort.repeats):
        for number, name in enumerate(effort.executors):
            yield Progress((repeat + number / len(effort.executors)) / effort.repeats, f"Baking {effort.models[0]}: {name}")
            with _word(name) as word:
                if word is None:
                    left_out = ["Dask: the package distributed is not installed for this Python."]
                    continue
                runs.setdefault(name, []).append(_timed(cloud, word, EXECUTORS[name], effort))
    best = {name: min(each, key=lambda run: run["capture_seconds"]) for name, each in runs.items()}
    figures = {"model": effort.models[0], "texels": cloud.report["texels"], "best": best, "runs": runs, "left_out": left_out}
    for words in left_out:
        print(f"Left out. {words}", file=sys.stderr)
    if {"dask", SPREAD} <= set(best):
        ratio = best["dask"]["capture_seconds"] / best[SPREAD]["capture_seconds"]
        figures["dask_over_processes"] = round(ratio, 3)
    return figures


def memory(effort: Effort) -> Steps[dict[str, Any]]:
    """Peak memory of a bake of at least 60,000 texels with 4,160 images, one sample a pixel, by two processes."""
    error = MEMORY_ERROR
    yield Progress(0.0, "Building clouds of some size")
    cloud = built_cloud(MEMORY_MODEL, effort, f"{100.0 * error:.2f}%")
    while cloud.report["texels"] < MEMORY_TEXELS:
        error *= math.sqrt(cloud.report["texels"] / MEMORY_TEXELS) * 0.99
        cloud = built_cloud(MEMORY_MODEL, effort, f"{100.0 * error:.2f}%")
    yield Progress(0.1, "Baking")
    grid = {"views": MEMORY_SIDE**2, "lights": MEMORY_SIDE**2, "capture_samples": 1}
    report = baked(cloud, "memory", cloud.path.with_name("views of memory"), replace(effort, **grid), "--executor", SPREAD)
    return {"texels": cloud.report["texels"], **{key: report[key] for key in ("renders", "peak_memory_mb", "workers_peak_memory_mb")}}


def _timed(cloud: Cloud, word: str, slots: int, effort: Effort) -> dict[str, Any]:
    """A bake from nothing. `over_bare`: wall time of captures and of everything, over the Cycles time that each of `slots` workers had."""
    work = Path(tempfile.mkdtemp(prefix="bake-", dir=cloud.path.parent))
    try:
        report = baked(cloud, "timed", work, effort, "--executor", word)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    bare = report["bare_render_seconds"] / slots
    capture = report["seconds"]["capture"]
    return {
        "renders": report["renders"],
        "bare_render_seconds": report["bare_render_seconds"],
        "capture_seconds": round(capture, 1),
        "wall_seconds": report["wall_seconds"],
        "seconds": report["seconds"],
        "capture_over_bare": round(capture / bare, 3),
        "wall_over_bare": round(report["wall_seconds"] / bare, 3),
    }


@contextmanager
def _word(name: str) -> Iterator[str | None]:
    """The word of an executor; for Dask a scheduler and workers that stand as long as the block, None where Dask is not installed."""
    if name != "dask":
        yield name
        return
    try:
        import distributed  # noqa: F401 - only whether it is there
    except ImportError:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="farfield-dask-", ignore_cleanup_errors=True) as folder:
        farm = Farm(Path(folder))
        try:
            farm.start_workers(PROCESSES)
            yield f"dask:{farm.address}"
        finally:
            farm.close()
