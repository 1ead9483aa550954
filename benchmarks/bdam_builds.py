"""Time, memory, disk, fly-overs and interruptions of builds, for `bench_bdam.py`."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from bdam_stores import Workplace, build_fractal, store_bytes, write_fractal
from bdam_terrains import AerialImage, FractalTerrain

from farfield.addon.core.bdam.store.terrain_store import TEXTURE_FOLDER
from farfield.addon.core.errors import FarfieldError

SCRIPT = Path(__file__).resolve().parent / "bdam_measured.py"
POLL_SECONDS = 0.1
GROWTH = 4  # times the side
KILL_SECONDS = 3.0  # after which a build may be killed; before, it loads Blender
ORPHAN_SECONDS = 20.0  # workers end within this time after their build was killed
BOUNDS = {"worker_mb": 250.0, "parent_mb": 150.0, "growth": 17.0, "geometry_seconds": 360.0, "texture_seconds": 180.0}
DISK_BOUNDS = {"bytes_per_sample": 8.0, "bytes_per_texel": 0.7}
FLIGHT_BOUNDS = {"extraction_ms": 3.0, "patches": 1000, "triangles": 350_000, "tiles": 64, "memory_mb": 160.0}


def measure_build(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure builds of a fractal terrain and of one with a quarter of the side, and of the textures of the large one."""
    figures: dict[str, Any] = {"bounds_for_8193": BOUNDS}
    sizes = [(given.size - 1) // GROWTH + 1, given.size]
    for size in sizes:
        source = write_fractal(workplace, FractalTerrain(size, given.seed))
        store = workplace.folder / f"fractal-{size}"
        shutil.rmtree(store, ignore_errors=True)
        figures[str(size)] = measure_process(build_arguments(source, store, workplace)) | {
            "bytes_per_sample": round(store_bytes(store) / size**2, 2)
        }
    small, large = (figures[str(size)] for size in sizes)
    figures["growth"] = {name: round(large[name] / small[name], 2) for name in ("seconds", "cpu_seconds")}
    figures["texture"] = measure_texture_build(given, workplace)
    return figures


def measure_texture_build(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure a build with the texture of an image of 2N x 2N pixels. Its stages tell the seconds of geometry and texture apart."""
    image = AerialImage(2 * (given.size - 1), given.seed)
    terrain = write_fractal(workplace, FractalTerrain(given.size, given.seed))
    source, store = write_image(workplace, image), workplace.folder / f"textured-{given.size}"
    shutil.rmtree(store, ignore_errors=True)
    figures = measure_process(build_arguments(terrain, store, workplace, source))
    size = store_bytes(store / TEXTURE_FOLDER)
    workplace.texture = figures | {"pixels": image.size, "bytes_per_texel": round(size / image.size**2, 3)}
    return workplace.texture


def measure_disk(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure the bytes of a store, by file."""
    with build_fractal(workplace, FractalTerrain(given.size, given.seed)) as store:
        sizes = {path.name: path.stat().st_size for path in sorted(store.folder.iterdir()) if path.is_file()}
        levels = [int(np.sum(level.counts[:, 0])) for level in store.levels]
    samples = given.size**2
    geometry = {name: round(size / samples, 3) for name, size in sizes.items()}
    texture = workplace.texture or measure_texture_build(given, workplace)
    return {
        "bounds": DISK_BOUNDS,
        "bytes_per_sample": round(sum(sizes.values()) / samples, 3),
        "by_file": geometry,
        "vertices_by_level": levels,
        "bytes_per_texel": texture["bytes_per_texel"],
    }


def measure_extraction(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure the cuts of a fly-over at one pixel."""
    build_fractal(workplace, FractalTerrain(given.size, given.seed)).close()
    folder = workplace.folder / f"fractal-{given.size}"
    figures = measure_process(["fly", str(folder), "--size", str(given.size), "--seed", str(given.seed)])
    return {"bounds": FLIGHT_BOUNDS} | figures


def measure_kills(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Kill a build with a texture again and again at random moments, resume it, and compare the bytes with those of a build that nobody
    disturbed."""
    size = min(given.size, 2049)
    random = np.random.default_rng([given.seed, 60])
    source = write_fractal(workplace, FractalTerrain(size, given.seed))
    image = write_image(workplace, AerialImage(2 * (size - 1), given.seed))
    undisturbed, killed = workplace.folder / "undisturbed", workplace.folder / "killed"
    for folder in (undisturbed, killed, killed.with_name("killed.build")):
        shutil.rmtree(folder, ignore_errors=True)

    def command(out: Path) -> list[str]:
        return [sys.executable, str(SCRIPT), *build_arguments(source, out, workplace, image)]

    started = time.perf_counter()
    _finish(command(undisturbed))
    seconds = time.perf_counter() - started
    expected = read_files(undisturbed)
    figures: dict[str, Any] = {"size": size, "kills": 0, "orphans": 0, "builds": 0, "builds_with_same_bytes": 0}
    figures |= {"finished_tasks": [], "finished_tiles": []}
    while figures["kills"] < given.kills or not killed.exists():
        if killed.exists():
            shutil.rmtree(killed)
        if figures["kills"] < given.kills:
            delay = float(random.uniform(min(KILL_SECONDS, 0.3 * seconds), seconds))
            outcome = _kill(command(killed), delay)
            if outcome is not None:
                figures["kills"] += 1
                figures["orphans"] += outcome
                work = killed.with_name("killed.build")
                figures["finished_tasks"].append(len(list(work.glob("blocks-*"))))
                figures["finished_tiles"].append(len(list((work / "textures").rglob("*.tile"))))
        else:
            _finish(command(killed))
        if killed.exists():
            figures["builds"] += 1
            figures["builds_with_same_bytes"] += read_files(killed) == expected
    figures["left_over"] = sorted(path.name for path in workplace.folder.glob("killed*") if path != killed)
    return figures


def write_image(workplace: Workplace, image: AerialImage) -> Path:
    """Return the file of an image, which is written if it does not exist yet."""
    path = workplace.folder / f"image-{image.size}.tif"
    if not path.exists():
        image.write(path)
    return path


def build_arguments(source: Path, out: Path, workplace: Workplace, image: Path | None = None) -> list[str]:
    """Return the arguments of bdam_measured.py for a build."""
    textures = [] if image is None else ["--image", str(image)]
    return ["build", str(source), "--out", str(out), "--executor", workplace.executor, *textures]


def _kill(command: list[str], delay: float) -> int | None:
    """Start a build, kill its process after `delay` seconds, and return how many of its workers live on; None if it ended before."""
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(delay)
    workers = find_descendants(process.pid)
    was_running = process.poll() is None
    process.kill()
    process.wait()
    return count_living(workers) if was_running else None


def measure_process(arguments: list[str]) -> dict[str, Any]:
    """Run bdam_measured.py; return what it prints, and the peak memory of its largest child process (only on Linux)."""
    with tempfile.TemporaryFile("w+") as stdout, tempfile.TemporaryFile("w+") as stderr:
        process = subprocess.Popen([sys.executable, str(SCRIPT), *arguments], stdout=stdout, stderr=stderr)
        peaks: dict[int, float] = {}
        while process.poll() is None:
            for child in find_descendants(process.pid):
                if read_command(child) == read_command(process.pid):
                    continue  # it has the memory of its parent until it runs another program
                peaks[child] = max(peaks.get(child, 0.0), read_peak_mb(child))
            time.sleep(POLL_SECONDS)
        for stream in (stdout, stderr):
            stream.seek(0)
        if process.returncode:
            raise FarfieldError(f"bdam_measured.py failed: {stderr.read().strip()}")
        figures = json.loads(stdout.read())
    return figures | {"children": len(peaks), "largest_child_mb": round(max(peaks.values(), default=0.0), 1)}


def find_descendants(process: int) -> list[int]:
    """Return the processes that a process has started, and those that they have. Only works on Linux."""
    children = []
    for path in Path("/proc").glob(f"{process}/task/*/children"):
        with suppress(OSError):
            children += [int(text) for text in path.read_text(encoding="ascii").split()]
    return children + [descendant for child in children for descendant in find_descendants(child)]


def read_peak_mb(process: int) -> float:
    """Return the peak memory of a process in MB, 0 if it has ended. Only works on Linux."""
    with suppress(OSError):
        for line in Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    return 0.0


def read_command(process: int) -> bytes:
    """Return the command line of a process, nothing if it has ended. Only works on Linux."""
    with suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes()
    return b""


def count_living(processes: list[int]) -> int:
    """Wait for processes to end and return how many still run after ORPHAN_SECONDS."""
    end = time.monotonic() + ORPHAN_SECONDS
    while any(_is_running(process) for process in processes) and time.monotonic() < end:
        time.sleep(POLL_SECONDS)
    return sum(_is_running(process) for process in processes)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
        state = Path(f"/proc/{process}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def _finish(command: list[str]) -> None:
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    if outcome.returncode:
        raise FarfieldError(f"bdam_measured.py failed: {outcome.stderr.strip()}")


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files in a folder by their names."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
