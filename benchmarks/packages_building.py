"""Part `building` of bench_packages.py: time and memory of a package of 200k triangles with a texture of 4096 x 4096, per stage."""

import re
import time
from argparse import Namespace
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from packages_bytes import build
from texmesh_chains import measure_cost, paint
from texmesh_levels import SPEED_RINGS, SPEED_SIDE, make_ball
from texmesh_models import TexturedModel

from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.jobs.progress import Progress
from lib import command_line

MAX_SECONDS, MAX_MEMORY_MB = 60.0, 2000.0
NOISE = 4.0  # standard deviation of the noise of the texture, of 255: photographs have some


class StageMeter:
    """Seconds, CPU seconds of all threads and peak memory so far of the stages that a task names, in their order."""

    def __init__(self) -> None:
        self.stages: list[dict[str, Any]] = []
        self._label, self._wall, self._cpu = "", time.perf_counter(), time.process_time()

    def note(self, progress: Progress) -> None:
        """End a stage where another one begins; stages in a row that differ only by numbers are one."""
        self.finish(re.sub(r" \d+ of \d+$", "", progress.label))

    def finish(self, label: str = "") -> None:
        """Add the time since the last call to the stage, and go on with `label`."""
        wall, cpu = time.perf_counter(), time.process_time()
        if not self.stages or self.stages[-1]["stage"] != self._label:
            self.stages.append({"stage": self._label, "seconds": 0.0, "cpu_seconds": 0.0})
        stage = self.stages[-1]
        stage["seconds"] = round(stage["seconds"] + wall - self._wall, 2)
        stage["cpu_seconds"] = round(stage["cpu_seconds"] + cpu - self._cpu, 2)
        stage["peak_memory_mb"] = round(command_line.peak_memory_mb())
        self._label, self._wall, self._cpu = label, wall, cpu


def measure_building(given: Namespace) -> dict[str, Any]:
    """Return seconds and peak memory of a package with default settings. The memory is that of the process: measure this part alone."""
    generator = np.random.default_rng(given.seed)
    mesh = make_ball(SPEED_RINGS, generator)
    model = TexturedModel(mesh, [paint_bytes(SPEED_SIDE, generator)])
    reset_peak_memory()
    meter = StageMeter()
    package, cost = measure_cost(lambda: build(model, "ball", on_progress=meter.note), MAX_SECONDS, MAX_MEMORY_MB)
    meter.finish()
    return {
        "triangles": len(mesh.triangles),
        **cost,
        "levels": package.report.levels,
        "mesh_bytes": package.report.mesh_bytes,
        "texture_bytes": package.report.texture_bytes,
        "stages": meter.stages,
    }


def reset_peak_memory() -> None:
    """Forget the peak memory of this process so far, that of its input, where the system can."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", "ascii")


def paint_bytes(side: int, generator: np.random.Generator) -> np.ndarray:
    """Return an image (side, side, 3) uint8 of soft spots with a little noise."""
    image = 255.0 * encode_signed_srgb(paint(side, generator))
    for row in image:
        row += NOISE * generator.standard_normal(row.shape)
    return np.rint(np.clip(image, 0.0, 255.0)).astype(np.uint8)
