"""Renders of some frames of a scene with the originals and with levels by distance, in another process, so that Blender stays usable:
to measure them, or to find the error with which a frame takes no longer than a budget.

The process gets the scene as a file, and writes the figures to one.
"""

import argparse
import json
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...compat import compositor_trees, set_file_format
from ...core.distance.forecasts import RENDER_STEPS, find_error, measure_overhead, predict_seconds
from ...core.errors import FarfieldError, FileError
from ...core.files.atomic_write import write_bytes_unsynced
from ...core.imaging.flip import compare, prepare_image
from ...core.jobs.core_worker import EXIT_ERROR, encode_error
from ...core.jobs.heartbeat import exit_when_run_ends
from ...core.jobs.progress import Progress
from ..imaging.images import read_pixels
from ..snapshots import explain, read_unsaved_images, write_blend, write_unsaved_images
from ..worker_processes import worker_command
from .placing import scale_errors, show_levels
from .views import choose_frames

FRAMES = 3
MAX_SAMPLES = 32
MAX_TRIALS = RENDER_STEPS + 4  # Renders of a search at most: of originals, with a single sample, and with both limits of the error.
MIN_TRIAL_SAMPLES, TRIAL_FRACTION = 8, 0.125  # Of trial renders: a part of those of the scene.
MIN_SECONDS = 0.2  # between two reports of progress
MEMORY = re.compile(r"Mem:\s*([\d.]+)([KMGT])")  # in the statistics of a render, in binary units
SAMPLE = re.compile(r"Sample (\d+)/(\d+)")
UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
ORIGINALS, LEVELS = "originals", "levels"
BLEND_FILE, METADATA_FILE, PROGRESS_FILE, FIGURES_FILE = "scene.blend", "scene.json", "progress.json", "figures.json"


@dataclass(frozen=True)
class Rendered:
    """A render. seconds: that it took. memory: bytes that Cycles used at most, 0 if the engine does not say. pixels: (H, W, 3) in 0..1."""

    seconds: float
    memory: int
    pixels: np.ndarray


def write_scene(folder: Path, scene: bpy.types.Scene, budget: tuple[float, float] | None = None) -> None:
    """Write into `folder` what the process needs of a scene. Unsaved paint strokes on images are included. Raises FileError.

    budget: seconds of a frame, and the error of its levels in pixels, at least which the process searches for; None to measure.
    """
    try:
        images = [image for image in bpy.data.images if image.source in {"FILE", "GENERATED"} and image.library is None]
        metadata = {"scene": scene.name, "frame": scene.frame_current, "budget": budget}
        metadata["images"] = write_unsaved_images(folder, images)
        write_blend(folder / BLEND_FILE, scene)
        (folder / METADATA_FILE).write_text(json.dumps(metadata), encoding="utf-8")
    except (OSError, RuntimeError) as error:
        raise FileError(f'The scene cannot be written to "{folder}": {explain(error)}.') from error


def render_command(folder: Path, heartbeat_file: Path, *, run_drivers: bool) -> list[str]:
    """Return the command line that renders the scene in `folder` with the user's preferences. run_drivers: see `open_snapshot`."""
    arguments = ["--folder", str(folder), "--heartbeat", str(heartbeat_file), *(["--run-drivers"] if run_drivers else [])]
    return worker_command("addon.bridge.distance.frame_renders", arguments, has_preferences=True)


def read_progress(folder: Path) -> Progress:
    """Return how far the process is."""
    try:
        return Progress(**json.loads((folder / PROGRESS_FILE).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return Progress(0.0, "Starting to render")


def main(arguments: list[str]) -> int:
    """Render the scene given by the arguments; return the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--heartbeat", type=Path, required=True)
    parser.add_argument("--run-drivers", action="store_true")
    options = parser.parse_args(arguments)
    exit_when_run_ends(options.heartbeat)
    try:
        scene, budget = _open_scene(options.folder, run_drivers=options.run_drivers)
        renders = _FrameRenders(options.folder, scene)
        figures = renders.measure() if budget is None else renders.search(*budget)
        write_bytes_unsynced(options.folder / FIGURES_FILE, json.dumps(figures).encode())
    except FarfieldError as error:
        print(encode_error(error), file=sys.stderr, flush=True)
        return EXIT_ERROR
    return 0


def _open_scene(folder: Path, *, run_drivers: bool) -> tuple[bpy.types.Scene, tuple[float, float] | None]:
    """Return the scene and the budget of `write_scene`. The scene is prepared to be rendered to PNG files and to no others."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = run_drivers
    metadata = json.loads((folder / METADATA_FILE).read_text(encoding="utf-8"))
    with bpy.data.libraries.load(str(folder / BLEND_FILE)) as (_, appended):
        appended.scenes = [metadata["scene"]]
    scene = appended.scenes[0]
    read_unsaved_images(folder, metadata["images"])
    scene.frame_set(metadata["frame"])
    image = scene.render.image_settings
    set_file_format(image, "PNG")
    image.color_mode, image.color_depth = "RGB", "8"
    for tree in compositor_trees(scene):
        for node in tree.nodes:
            node.mute = node.mute or node.bl_idname == "CompositorNodeOutputFile"
    return scene, metadata["budget"]


def _compare(before: Rendered, after: Rendered) -> float:
    return float(compare(prepare_image(before.pixels), prepare_image(after.pixels)).mean())


class _FrameRenders:
    """The renders of a scene, which say how far they are."""

    def __init__(self, folder: Path, scene: bpy.types.Scene) -> None:
        self._folder, self._scene, self._last_report = folder, scene, 0.0
        self._frames = choose_frames(scene, FRAMES)
        self._count = 2 * len(self._frames)

    def measure(self) -> dict[str, object]:
        """Return the figures: the number of frames, their mean FLIP, and mean seconds and maximum memory for originals and levels.

        Raises:
            FarfieldError: Blender cannot render the scene.
        """
        if self._scene.render.engine == "CYCLES":
            self._scene.cycles.samples = min(self._scene.cycles.samples, MAX_SAMPLES)
        found: dict[str, list[Rendered]] = {ORIGINALS: [], LEVELS: []}
        for number, frame in enumerate(self._frames):
            self._scene.frame_set(frame)
            for half, (name, is_shown) in enumerate(((ORIGINALS, False), (LEVELS, True))):
                show_levels(self._scene, is_shown)
                found[name].append(self._render(2 * number + half, f"Rendering frame {frame} with {name}"))
        pairs = zip(found[ORIGINALS], found[LEVELS], strict=True)
        flips = [_compare(before, after) for before, after in pairs]
        figures = {
            name: {"seconds": float(np.mean([item.seconds for item in renders])), "memory": max(item.memory for item in renders)}
            for name, renders in found.items()
        }
        return {"frames": len(self._frames), "flip": float(np.mean(flips)), **figures}

    def search(self, seconds: float, min_error: float) -> dict[str, object]:
        """Return the smallest error, at least `min_error`, with which a frame takes at most this long, or None; and of each error that was
        tried, the error, seconds of a whole frame, and FLIP to the originals.

        Raises:
            FarfieldError: Blender cannot render the scene.
        """
        scene, cycles, self._count = self._scene, self._scene.cycles, MAX_TRIALS
        samples = cycles.samples
        tried = min(max(round(TRIAL_FRACTION * samples), MIN_TRIAL_SAMPLES), MAX_SAMPLES, samples)
        scene.frame_set(self._frames[len(self._frames) // 2])
        cycles.samples = tried
        show_levels(scene, False)
        original = self._render(0, "Rendering the originals")
        show_levels(scene, True)
        cycles.samples = 1
        single = self._render(1, "Rendering levels").seconds
        cycles.samples, error = tried, min_error
        trials: list[tuple[float, float, float]] = []
        overhead: float | None = None

        def fits(candidate: float) -> bool:
            nonlocal error, overhead
            scale_errors(scene, candidate / error)
            error = candidate
            found = self._render(len(trials) + 2, f"Rendering levels with a Max Error of {candidate:.3g}")
            if overhead is None:
                overhead = measure_overhead(single, found.seconds, tried)
            trials.append((candidate, predict_seconds(found.seconds, tried, samples, overhead), _compare(original, found)))
            return trials[-1][1] <= seconds

        return {"error": find_error(fits, min_error, RENDER_STEPS), "trials": trials}

    def _render(self, number: int, label: str) -> Rendered:
        peak, path = 0, self._folder / f"{number}.png"

        def read_statistics(statistics: str, *_others: object) -> None:
            nonlocal peak
            memory, sample = MEMORY.search(str(statistics)), SAMPLE.search(str(statistics))
            if memory is not None:
                peak = max(peak, int(float(memory[1]) * UNITS[memory[2]]))
            if sample is not None and time.monotonic() - self._last_report > MIN_SECONDS:
                self._report(number + int(sample[1]) / max(int(sample[2]), 1), label)

        self._report(number, label)
        self._scene.render.filepath = str(path)
        bpy.app.handlers.render_stats.append(read_statistics)
        start = time.perf_counter()
        try:
            bpy.ops.render.render(write_still=True, scene=self._scene.name)
        except RuntimeError as error:
            raise FarfieldError(f"The scene cannot be rendered: {explain(error)}.") from error
        finally:
            bpy.app.handlers.render_stats.remove(read_statistics)
        seconds = time.perf_counter() - start
        image = bpy.data.images.load(str(path), check_existing=False)
        try:
            return Rendered(seconds, peak, read_pixels(image)[..., :3])
        finally:
            bpy.data.images.remove(image)

    def _report(self, renders: float, label: str) -> None:
        """Write that so many `renders` are finished."""
        self._last_report = time.monotonic()
        fraction = min(renders / self._count, 1.0)
        write_bytes_unsynced(self._folder / PROGRESS_FILE, json.dumps({"fraction": fraction, "label": label}).encode())
