"""Relightable clouds side by side with what they are held against, under held-out views and suns."""

import json
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from btf_bakes import Cloud, Effort, baked, built_cloud

import btf
import scene_files
from baselines import decimated, octahedral_impostor
from contact_sheet import write_png
from farfield.addon.core.errors import FarfieldError, SettingsError
from farfield.addon.core.progress import Steps, finish, scaled
from farfield.addon.operators.billboards_clouds import StandingCloud, clouds_in
from flip import mean_flip
from relighting import Contestant, Relighting, encoded, held_out_pairs, plain_twin, relight, relighting_sheet

SIZES = {"switch": 1.0, "twice": 2.0}  # pixels of the error
UNREFINED = "--no-refine"
LPCA = ("--codec", "lpca", "--clusters", "32", "--cluster-components", "8")
COLUMNS = 6
RELIGHTABLE = "relightable.blend"
KEPT = ("renders", "bare_render_seconds", "raw_bytes", "compressed_bytes", "seconds", "peak_memory_mb", "workers_peak_memory_mb")


def pictures(effort: Effort) -> Steps[dict[str, Any]]:
    """Likeness of every model's relightable cloud and of its rivals, and how far the textures were compressed."""
    figures = {}
    for number, name in enumerate(effort.models):
        steps = _model(name, effort)
        figures[name] = yield from scaled(steps, number / len(effort.models), (number + 1) / len(effort.models))
    return figures


def _model(name: str, effort: Effort) -> Steps[dict[str, Any]]:
    cloud = built_cloud(name, effort, effort.error)
    work = cloud.path.with_name(f"views {effort.views} {effort.lights} {effort.capture_samples}")
    reports = {"relightable": baked(cloud, "relightable", work, effort)}
    left_out = []
    if UNREFINED in btf.parser().format_help():
        reports["unrefined"] = baked(cloud, "unrefined", work, effort, UNREFINED)
    else:
        left_out.append(f"Scores without refinement: scripts/btf.py has no {UNREFINED}.")
    if effort.lpca:
        reports["lpca"] = baked(cloud, "lpca", work, effort, *LPCA)
    figures: dict[str, Any] = {"error": effort.error, **{key: cloud.report[key] for key in ("quads", "texels")}}
    figures["views"], figures["lights"] = effort.views, effort.lights
    figures["bakes"] = {variant: _bake_figures(report) for variant, report in reports.items()}
    with _contest(cloud, reports, effort, left_out) as (standing, others):
        pairs = held_out_pairs(effort.pairs, cloud.upper)
        for number, size in enumerate(effort.sizes):
            finer = SIZES[size]
            pixel = standing.errors[0] / finer
            steps = relight(standing.sources, standing.levels[0], others, pixel, pairs, effort.samples, effort.reference_samples)
            compared = yield from scaled(steps, number / len(effort.sizes), (number + 1) / len(effort.sizes))
            figures[size] = _scores(compared, left_out)
            print(f"{name}, {size}: {json.dumps(figures[size])}", file=sys.stderr)
            if effort.sheets is not None:
                _draw(effort.sheets, f"{name} {size}", f"{name}, {cloud.report['quads']} quads, error = {finer:g} px", compared)
    for words in left_out:
        print(f"{name}: left out. {words}", file=sys.stderr)
    return {**figures, "left_out": left_out}


def _bake_figures(report: dict[str, Any]) -> dict[str, Any]:
    """What a bake took and gave; `psnr` is of the compressed against the captured textures."""
    psnr = report["levels"][0]["fits"][-1]["psnr"]
    ratio = report["raw_bytes"] / report["compressed_bytes"]
    return {**{key: report[key] for key in KEPT}, "compression": round(ratio, 1), "psnr": round(psnr, 2)}


@contextmanager
def _contest(
    cloud: Cloud, reports: dict[str, dict[str, Any]], effort: Effort, left_out: list[str]
) -> Iterator[tuple[StandingCloud, list[Contestant]]]:
    """The file with the relightable cloud, open, and all that it is compared with, in its scene."""
    scene_files.open_scene(cloud.path.with_name(RELIGHTABLE))
    standing = clouds_in(bpy.context.scene)[0]
    level = standing.levels[0]
    others = [
        Contestant(variant, [_appended(cloud.path.with_name(f"{variant}.blend"), level.name)], relightable=True)
        for variant in reports
        if variant != "relightable"
    ]
    others.append(Contestant("plain", [plain_twin(level)]))
    try:
        size = reports["relightable"]["compressed_bytes"]
        impostor = finish(octahedral_impostor(standing.sources, size, effort.samples))
        others.append(Contestant("impostor", impostor.objects, impostor.face))
    except SettingsError as error:
        left_out.append(str(error))
    try:
        others.append(Contestant("decimated", [decimated(standing.sources, 2 * cloud.report["quads"])]))
    except SettingsError as error:
        left_out.append(str(error))
    yield standing, others


def _appended(path: Path, name: str) -> bpy.types.Object:
    """The object of that name in another file, as a new one in this scene."""
    with bpy.data.libraries.load(str(path)) as (held, appended):
        if name not in held.objects:
            raise FarfieldError(f'"{path}" holds no "{name}"; remove the work folder and measure again.')
        appended.objects = [name]
    made = appended.objects[0]
    bpy.context.scene.collection.objects.link(made)
    return made


def _scores(compared: Relighting, left_out: list[str]) -> dict[str, Any]:
    """Mean scores by contestant, and by how many decibels of PSNR the relightable cloud is ahead."""
    figures: dict[str, Any] = compared.figures()
    for name, taken in zip(compared.names[1:], compared.pictures[1:], strict=True):
        errors = mean_flip([encoded(*pair) for pair in zip(compared.pictures[0], taken, strict=True)])
        if errors is None:
            words = "FLIP: the environment of the peers does not stand; make it with scripts/peers.py."
            if words not in left_out:
                left_out.append(words)
            continue
        figures[name]["flip"] = round(float(np.mean(errors)), 4)
    ours = figures["relightable"]["psnr"]
    ahead = {name: round(ours - figures[name]["psnr"], 2) for name in compared.names[2:] if math.isfinite(figures[name]["psnr"])}
    return {**figures, "ahead_db": ahead}


def _draw(folder: Path, name: str, title: str, compared: Relighting) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    columns = np.linspace(0, len(compared.views) - 1, min(COLUMNS, len(compared.views))).round().astype(int).tolist()
    write_png(folder / f"{name}.png", relighting_sheet(title, compared, columns))
