"""Renders of some frames with the originals and with levels by distance: time, memory, and the difference that a viewer perceives."""

import json
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...bridge.distance.placing import has_levels, show_levels, shows_levels
from ...bridge.distance.views import choose_frames
from ...bridge.imaging.images import read_pixels
from ...bridge.objects import find_by_uid
from ...compat import set_file_format
from ...core.errors import GeometryError
from ...core.files.temporary_folders import create_temporary_folder
from ...core.imaging.flip import compare, prepare_image
from ...core.jobs.progress import Progress, Steps
from ...core.messages import format_bytes, format_count

FRAMES = 3
MAX_SAMPLES = 32
MEMORY = re.compile(r"Mem:\s*([\d.]+)([KMGT])")  # In the statistics of a render, in binary units.
UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
ORIGINALS, LEVELS = "originals", "levels"


@dataclass(frozen=True)
class Rendered:
    """A render. seconds: that it took. memory: bytes that Cycles used at most, 0 if the engine does not say. pixels: (H, W, 3) in 0..1."""

    seconds: float
    memory: int
    pixels: np.ndarray


@dataclass
class MeasureJob:
    """Renders up to `FRAMES` frames twice each, and stores the figures for the panel."""

    core_fraction = 0.0

    scene_uid: int

    def core_steps(self) -> Steps[None]:
        """Do nothing: all of it is renders."""
        yield Progress(0.0, "Rendering")

    def scene_steps(self, _core_result: None) -> Steps[str]:
        """Render and compare.

        Raises:
            GeometryError: the scene or its levels were removed meanwhile.
        """
        scene = find_by_uid(bpy.data.scenes, self.scene_uid)
        if scene is None or not has_levels(scene):
            raise GeometryError("The scene or its levels were removed; start again.")
        frames = choose_frames(scene, FRAMES)
        found: dict[str, list[Rendered]] = {ORIGINALS: [], LEVELS: []}
        flips = []
        with _prepared(scene) as folder:
            for number, frame in enumerate(frames):
                for half, (name, is_shown) in enumerate(((ORIGINALS, False), (LEVELS, True))):
                    yield Progress((number + 0.5 * half) / len(frames), f"Rendering frame {frame} with {name}")
                    if frame != scene.frame_current:
                        scene.frame_set(frame)
                    show_levels(scene, is_shown)
                    found[name].append(_render(scene, folder / f"{name}.png"))
                flips.append(_compare(found[ORIGINALS][-1].pixels, found[LEVELS][-1].pixels))
        figures = {name: _summarize(renders) for name, renders in found.items()}
        scene.farfield_distance.figures = json.dumps({"frames": len(frames), "flip": float(np.mean(flips)), **figures})
        return describe_figures(scene.farfield_distance.figures)


def _summarize(renders: list[Rendered]) -> dict[str, float]:
    return {"seconds": float(np.mean([item.seconds for item in renders])), "memory": max(item.memory for item in renders)}


def describe_figures(figures: str) -> str:
    """Return one sentence about stored figures."""
    values = json.loads(figures)
    before, after = values[ORIGINALS], values[LEVELS]
    memory = f", {format_bytes(after['memory'])} instead of {format_bytes(before['memory'])} of memory" if before["memory"] else ""
    frames = format_count(values["frames"], "frame")
    return f"Mean of {frames}: {after['seconds']:,.1f} s instead of {before['seconds']:,.1f} s{memory}, FLIP {values['flip']:.3f}."


def _compare(first: np.ndarray, second: np.ndarray) -> float:
    return float(compare(prepare_image(first), prepare_image(second)).mean())


@contextmanager
def _prepared(scene: bpy.types.Scene) -> Iterator[Path]:
    """Let a scene render quickly to PNG files, yield a temporary folder, and restore the frame, its settings and what it shows."""
    render, image, cycles = scene.render, scene.render.image_settings, getattr(scene, "cycles", None)
    names = ["media_type"] if hasattr(image, "media_type") else []
    kept_image = {name: getattr(image, name) for name in [*names, "file_format", "color_mode", "color_depth"]}
    kept_path, samples = render.filepath, None if cycles is None else cycles.samples
    frame, subframe, is_shown = scene.frame_current, scene.frame_subframe, shows_levels(scene.objects)
    folder = create_temporary_folder()
    try:
        set_file_format(image, "PNG")
        image.color_mode, image.color_depth = "RGB", "8"
        if cycles is not None:
            cycles.samples = min(cycles.samples, MAX_SAMPLES)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        for name, value in kept_image.items():
            setattr(image, name, value)
        render.filepath = kept_path
        if cycles is not None:
            cycles.samples = samples
        show_levels(scene, is_shown)
        scene.frame_set(frame, subframe=subframe)


def _render(scene: bpy.types.Scene, path: Path) -> Rendered:
    peak = 0

    def read_statistics(statistics: str, *_others: object) -> None:
        nonlocal peak
        match = MEMORY.search(str(statistics))
        if match is not None:
            peak = max(peak, int(float(match[1]) * UNITS[match[2]]))

    scene.render.filepath = str(path)
    bpy.app.handlers.render_stats.append(read_statistics)
    start = time.perf_counter()
    try:
        bpy.ops.render.render(write_still=True, scene=scene.name)
    finally:
        bpy.app.handlers.render_stats.remove(read_statistics)
    seconds = time.perf_counter() - start
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        return Rendered(seconds, peak, read_pixels(image)[..., :3])
    finally:
        bpy.data.images.remove(image)
