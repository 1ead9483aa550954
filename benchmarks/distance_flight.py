"""A flight through the valley: frames with full geometry, with levels by distance, by Decimate and with impostors, each by its own process.

Pictures, scenes and figures of frames stay in a folder; what is there is not made again.
"""

import json
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from distance_impostors import write_impostor_scene
from distance_renders import read_image, render
from distance_valley import ValleyOptions, build_valley

from farfield.addon.bridge import lod_crossfade
from farfield.addon.bridge.distance.chains import Chain, read_chains
from farfield.addon.core.distance.settings import DistanceSettings
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.distance.job import describe_chain, prepare
from farfield.addon.operators.job_run import run_job
from lib import command_line
from lib.flip_metric import mean_flip

VARIANTS = ("full", "levels", "decimate", "impostors")
OTHER_SEED = 1


def measure_flight(options: ValleyOptions, settings: DistanceSettings, frames: list[int], folder: Path) -> dict[str, Any]:
    """Return the figures of all variants, and their ratios to full geometry."""
    figures = build_scenes(options, settings, folder)
    if not (folder / "impostors.blend").exists():
        write_impostor_scene(folder / "decimate.blend", folder / "impostors.blend")
    found: dict[str, list[dict[str, Any]]] = {}
    for frame in frames:
        for variant in VARIANTS:
            found.setdefault(variant, []).append(_render_once(folder, variant, frame, 0))
    _render_once(folder, "full", frames[0], OTHER_SEED)
    full = found["full"]
    for variant in VARIANTS:
        rows = found[variant]
        figures[variant] = {key: round(_mean(rows, key), 2) for key in rows[0] if rows[0][key] is not None}
        figures[variant] |= {f"{key}_ratio": round(_mean(rows, key) / _mean(full, key), 3) for key in rows[0] if rows[0][key] is not None}
    return figures | _compare(frames, folder)


def build_scenes(options: ValleyOptions, settings: DistanceSettings, folder: Path) -> dict[str, Any]:
    """Build the valley, make it ready, replace the levels by those of Decimate, and save the three scenes. Returns figures of the build."""
    report = folder / "build.json"
    if report.exists():
        return json.loads(report.read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)
    objects = build_valley(options)
    scene, full = bpy.context.scene, folder / "full.blend"
    # Full geometry has the limit of transparent bounces that levels have, or its stacked leaf cards would be black and cheaper.
    bounces = scene.cycles.transparent_max_bounces
    bpy.ops.wm.save_as_mainfile(filepath=str(full))
    job = prepare(scene, objects, settings)
    started, cpu = time.perf_counter(), time.process_time()
    message = run_to_end(run_job(job), command_line.ProgressLine().show)
    seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - cpu
    raised = scene.cycles.transparent_max_bounces
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "levels.blend"))
    started = time.perf_counter()
    for chain in read_chains():
        _replace_by_decimate(chain, settings.fade_range)
    decimate_seconds = time.perf_counter() - started
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "decimate.blend"))
    if raised != bounces:
        bpy.ops.wm.open_mainfile(filepath=str(full))
        bpy.context.scene.cycles.transparent_max_bounces = raised
        bpy.ops.wm.save_as_mainfile(filepath=str(full))
    figures = {
        "build_seconds": round(seconds, 1),
        "build_cpu_seconds": round(cpu_seconds, 1),
        "decimate_seconds": round(decimate_seconds, 1),
        "bounces": raised,
        "message": message,
        "chains": [describe_chain(*item) for item in job.chains],
    }
    command_line.write_report(report.absolute(), figures)
    return figures


def _replace_by_decimate(chain: Chain, fade_range: float) -> None:
    """Replace the levels by meshes of Decimate with as many triangles, at the same distances."""
    limits = [*chain.pixel_sizes, lod_crossfade.MAX_PIXEL]
    for number in range(1, len(chain.collections)):
        meshes = [_decimate(original, chain.triangles[number] / chain.triangles[0]) for original in chain.collections[0].objects]
        for collections in filter(None, (chain.collections, chain.fading)):
            for item in collections[number].objects[:]:
                collections[number].objects.unlink(item)
            for original, mesh in zip(collections[0].objects, meshes, strict=True):
                item = original.copy()
                item.data = mesh
                collections[number].objects.link(item)
                if lod_crossfade.CROSSFADE in item:
                    lod_crossfade.set_limits(item, *limits[number : number + 2], fade_range)


def _decimate(original: bpy.types.Object, ratio: float) -> bpy.types.Mesh:
    """Return a mesh with a part of the triangles of an object."""
    scene = bpy.context.scene
    item = bpy.data.objects.new("Decimated", original.data)
    scene.collection.objects.link(item)
    try:
        item.modifiers.new("Decimate", "DECIMATE").ratio = ratio
        bpy.context.view_layer.update()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return bpy.data.meshes.new_from_object(item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph)
    finally:
        bpy.data.objects.remove(item)


def _render_once(folder: Path, variant: str, frame: int, seed: int) -> dict[str, Any]:
    """Return the figures of a frame, which is rendered unless it was before."""
    report = _path(folder, variant, frame, seed).with_suffix(".json")
    if not report.exists():
        command_line.write_report(report.absolute(), render(folder / f"{variant}.blend", report.with_suffix(".png"), seed, frame))
    return json.loads(report.read_text(encoding="utf-8"))


def _path(folder: Path, variant: str, frame: int, seed: int) -> Path:
    return folder / f"{variant}_{frame}_{seed}.png"


def _mean(rows: list[dict[str, Any]], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))


def _compare(frames: list[int], folder: Path) -> dict[str, Any]:
    """Return FLIP to full geometry, and how much FLIP between neighboring frames is above that of full geometry."""
    images = {(variant, frame): read_image(_path(folder, variant, frame, 0)) for variant in VARIANTS for frame in frames}
    noise = read_image(_path(folder, "full", frames[0], OTHER_SEED))
    pairs = [(images["full", frame], images[variant, frame]) for variant in VARIANTS[1:] for frame in frames]
    steps = list(pairwise(frames))
    pairs += [(images[variant, first], images[variant, second]) for variant in VARIANTS for first, second in steps]
    flips = mean_flip([*pairs, (images["full", frames[0]], noise)])
    if flips is None:
        return {}
    flips, of_noise = np.array(flips[:-1]), flips[-1]
    count = (len(VARIANTS) - 1) * len(frames)
    to_full = flips[:count].reshape(len(VARIANTS) - 1, -1).mean(axis=1)
    found: dict[str, Any] = {"flip_of_noise": round(of_noise, 4)}
    found |= {f"flip_of_{variant}": round(float(flip), 4) for variant, flip in zip(VARIANTS[1:], to_full, strict=True)}
    if steps:
        between = flips[count:].reshape(len(VARIANTS), -1).mean(axis=1)
        found |= {f"pops_of_{variant}": round(float(flip - between[0]), 4) for variant, flip in zip(VARIANTS[1:], between[1:], strict=True)}
    return found
