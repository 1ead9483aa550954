"""Renders of frames of a scene file, each by a process of its own, with their CPU time and memory."""

import json
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

RENDER = """
import json, re, sys, time
from pathlib import Path
import bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene = bpy.context.scene
scene.cycles.seed = int(sys.argv[3])
scene.frame_set(int(sys.argv[4]))
scene.render.filepath = sys.argv[2]
peaks = [0.0]
def note(*given):
    peaks.extend(float(size) for text in given if isinstance(text, str) for size in re.findall(r"Mem: ?([\\d.]+)M", text))
bpy.app.handlers.render_stats.append(note)
started, cpu = time.perf_counter(), time.process_time()
bpy.ops.render.render(write_still=True)
seconds = {"seconds": round(time.perf_counter() - started, 2), "cpu_seconds": round(time.process_time() - cpu, 2)}
status = Path("/proc/self/status")  # Other counters include the memory of the process that started this one.
peak = int(re.search(r"VmHWM:\\s+(\\d+) kB", status.read_text())[1]) if status.exists() else None
memory = {"peak_memory_mb": None if peak is None else round(peak * 1024e-6, 1), "cycles_memory_mb": max(peaks)}
print(json.dumps({**seconds, **memory}))
bpy.ops.wm.read_factory_settings(use_empty=True)
"""


def render(scene: Path, image: Path, seed: int, frame: int = 1) -> dict[str, float | None]:
    """Render a frame in a new process. Returns its seconds, the peak memory of the process, and that of Cycles as it reports it."""
    command = [sys.executable, "-c", RENDER, str(scene), str(image), str(seed), str(frame)]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return json.loads(next(line for line in reversed(output.splitlines()) if line.startswith("{")))


def read_image(path: Path) -> np.ndarray:
    """Return the pixels (H, W, 3) of a PNG file, sRGB values in 0..1, row 0 at the bottom."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.zeros(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, -1)[..., :3].copy()
