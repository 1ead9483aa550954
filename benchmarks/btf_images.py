"""Comparison of relightable clouds with other representations, for held-out views and Sun directions."""

import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from btf_bakes import BenchmarkCloud, BenchmarkOptions, bake, build_cloud

import btf
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.core.errors import FarfieldError, SettingsError
from farfield.addon.core.jobs.progress import Steps, run_to_end, subprogress
from lib import scene_files
from lib.baselines import build_octahedral_impostor, decimate
from lib.contact_sheet import write_png
from lib.flip_metric import mean_flip
from lib.relighting import (
    Candidate,
    RelightingComparison,
    compare_relighting,
    copy_with_pbr_material,
    crop_and_encode,
    draw_relighting_sheet,
    held_out_pairs,
)

SIZES = {"switch": 1.0, "twice": 2.0}  # pixels per error of the cloud
NO_REFINE = "--no-refine"
LPCA = ("--codec", "lpca", "--clusters", "32", "--cluster-components", "8")
COLUMNS = 6
RELIGHTABLE = "relightable.blend"
REPORT_KEYS = ("renders", "bare_render_seconds", "raw_bytes", "compressed_bytes", "seconds", "peak_memory_mb", "workers_peak_memory_mb")


def compare_images(options: BenchmarkOptions) -> Steps[dict[str, Any]]:
    """Score the relightable cloud of every model and its alternatives, and report how far the textures were compressed."""
    figures = {}
    for index, name in enumerate(options.models):
        steps = _compare_model(name, options)
        figures[name] = yield from subprogress(steps, index / len(options.models), (index + 1) / len(options.models))
    return figures


def _compare_model(name: str, options: BenchmarkOptions) -> Steps[dict[str, Any]]:
    cloud = build_cloud(name, options, options.error)
    work = cloud.path.with_name(f"views {options.views_per_side} {options.lights_per_side} {options.capture_samples}")
    reports = {"relightable": bake(cloud, "relightable", work, options)}
    skipped = []
    if NO_REFINE in btf.build_parser().format_help():
        reports["unrefined"] = bake(cloud, "unrefined", work, options, NO_REFINE)
    else:
        skipped.append(f"Scores without refinement: scripts/btf.py has no {NO_REFINE}.")
    if options.lpca:
        reports["lpca"] = bake(cloud, "lpca", work, options, *LPCA)
    figures: dict[str, Any] = {"error": options.error, **{key: cloud.report[key] for key in ("quads", "texels")}}
    figures["views"], figures["lights"] = options.views_per_side**2, options.lights_per_side**2
    figures["bakes"] = {variant: _summarize_bake(report) for variant, report in reports.items()}
    with _open_candidates(cloud, reports, options, skipped) as (scene_cloud, others):
        pairs = held_out_pairs(options.pairs, cloud.upper)
        for index, size in enumerate(options.sizes):
            scale = SIZES[size]
            pixel_size = scene_cloud.errors[0] / scale
            steps = compare_relighting(
                scene_cloud.sources, scene_cloud.levels[0], others, pixel_size, pairs, options.samples, options.reference_samples
            )
            comparison = yield from subprogress(steps, index / len(options.sizes), (index + 1) / len(options.sizes))
            figures[size] = _compute_scores(comparison, skipped)
            print(f"{name}, {size}: {json.dumps(figures[size])}", file=sys.stderr)
            if options.sheets is not None:
                _write_sheet(options.sheets, f"{name} {size}", f"{name}, {cloud.report['quads']} quads, error = {scale:g} px", comparison)
    for reason in skipped:
        print(f"{name}: skipped. {reason}", file=sys.stderr)
    return {**figures, "skipped": skipped}


def _summarize_bake(report: dict[str, Any]) -> dict[str, Any]:
    """Return the cost and results of a bake. `psnr`: of the compressed relative to the captured textures."""
    psnr = report["levels"][0]["component_errors"][-1]["psnr"]
    ratio = report["raw_bytes"] / report["compressed_bytes"]
    return {**{key: report[key] for key in REPORT_KEYS}, "compression": round(ratio, 1), "psnr": round(psnr, 2)}


@contextmanager
def _open_candidates(
    cloud: BenchmarkCloud, reports: dict[str, dict[str, Any]], options: BenchmarkOptions, skipped: list[str]
) -> Iterator[tuple[SceneCloud, list[Candidate]]]:
    """Open the file with the relightable cloud, and add everything that it is compared with to its scene."""
    scene_files.open_scene(cloud.path.with_name(RELIGHTABLE))
    scene_cloud = clouds_in(bpy.context.scene)[0]
    level = scene_cloud.levels[0]
    others = [
        Candidate(variant, [_append_object(cloud.path.with_name(f"{variant}.blend"), level.name)], relightable=True)
        for variant in reports
        if variant != "relightable"
    ]
    others.append(Candidate("PBR", [copy_with_pbr_material(level)]))
    try:
        size = reports["relightable"]["compressed_bytes"]
        impostor = run_to_end(build_octahedral_impostor(scene_cloud.sources, size, options.samples))
        others.append(Candidate("octahedral impostor", impostor.objects, impostor.face_viewer))
    except SettingsError as error:
        skipped.append(str(error))
    try:
        others.append(Candidate("decimated", [decimate(scene_cloud.sources, 2 * cloud.report["quads"])]))
    except SettingsError as error:
        skipped.append(str(error))
    yield scene_cloud, others


def _append_object(path: Path, name: str) -> bpy.types.Object:
    """Append the object of that name from another file to this scene."""
    with bpy.data.libraries.load(str(path)) as (held, appended):
        if name not in held.objects:
            raise FarfieldError(f'"{path}" does not contain "{name}"; remove the work folder and measure again.')
        appended.objects = [name]
    appended_object = appended.objects[0]
    bpy.context.scene.collection.objects.link(appended_object)
    return appended_object


def _compute_scores(comparison: RelightingComparison, skipped: list[str]) -> dict[str, Any]:
    """Return the mean scores per candidate, and the PSNR of the relightable cloud relative to each of them."""
    figures: dict[str, Any] = comparison.mean_scores()
    for name, renders in zip(comparison.names[1:], comparison.renders[1:], strict=True):
        errors = mean_flip([crop_and_encode(*pair) for pair in zip(comparison.renders[0], renders, strict=True)])
        if errors is None:
            reason = "FLIP: the environment of the reference tools is missing; create it with scripts/reference_tools.py."
            if reason not in skipped:
                skipped.append(reason)
            continue
        figures[name]["flip"] = round(float(np.mean(errors)), 4)
    relightable_psnr = figures["relightable"]["psnr"]
    psnr_lead = {
        name: round(relightable_psnr - figures[name]["psnr"], 2) for name in comparison.names[2:] if math.isfinite(figures[name]["psnr"])
    }
    return {**figures, "psnr_lead_db": psnr_lead}


def _write_sheet(folder: Path, name: str, title: str, comparison: RelightingComparison) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    columns = np.linspace(0, len(comparison.views) - 1, min(COLUMNS, len(comparison.views))).round().astype(int).tolist()
    write_png(folder / f"{name}.png", draw_relighting_sheet(title, comparison, columns))
