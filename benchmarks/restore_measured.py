"""Restore one image in a process of its own, for `restore_costs.py`: `python3 benchmarks/restore_measured.py INPUT.npz`.

INPUT holds `image` (H, W, C) float32 and `mask` (H, W) bool. Prints the seconds, and the peak memory above that of the process after its
imports, as JSON. The image itself is part of that memory.
"""

import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import numpy as np
import scipy.fft
import scipy.ndimage
import scipy.sparse.linalg
import scipy.spatial  # noqa: F401 - all of SciPy that a restoration needs counts as imports

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.restore.restoration import restore
from farfield.addon.core.restore.settings import RestoreSettings
from lib import command_line, run_files


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Restore the image; returns the measurements as JSON."""
    parser = command_line.Parser(prog="restore_measured.py", description="Restore one image and measure time and memory.")
    parser.add_argument("input", type=run_files.parse_path, help="an .npz file with the arrays image and mask")
    given = parser.parse_args(arguments)
    before = memory_mb("VmRSS")
    with np.load(given.input, allow_pickle=False) as file:
        image, mask = file["image"], file["mask"]
    started = time.perf_counter()
    restoration = run_to_end(restore(image, mask, RestoreSettings()))
    seconds = time.perf_counter() - started
    figures = {"seconds": round(seconds, 2), "kappa": restoration.sub_bands, "holes": restoration.hole_count}
    figures |= {"peak_memory_above_imports_mb": round(memory_mb("VmHWM") - before, 1), "imports_mb": round(before, 1)}
    figures |= {"image_and_mask_mb": round((image.nbytes + mask.nbytes) / 1e6, 1)}
    return json.dumps(figures | {"stages": {name: round(value, 2) for name, value in restoration.seconds.items()}})


def memory_mb(name: str) -> float:
    """Return the resident memory (VmRSS) or its peak (VmHWM) of this process in MB (10^6 bytes).

    Linux counts them per program. Elsewhere both are the peak memory of the process, which on some systems is never below that of the
    process that started it.
    """
    status = Path("/proc/self/status")
    if not status.is_file():
        return command_line.peak_memory_mb()
    values = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines() if ":" in line)
    return int(values[name].split()[0]) * 1024 / 1e6


if __name__ == "__main__":
    command_line.run(main)
