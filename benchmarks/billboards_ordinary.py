"""Clouds of ordinary models for `bench_billboards.py`: by default settings, level by level, compared with what a user would take instead.

These are Blender's Decimate with as many triangles as the level and, with --impostors, an octahedral impostor with as many bytes of
textures. All are rendered at the level's switch distance, where its error is one pixel, from random views with a high Sun, a low Sun and
the sky alone, in turn. Scores are means over the views on the rectangle of the object in front of mid-gray.

Coverage and luminance are ratios of the sums over the object, cloud to source, at sizes of CHAIN pixels, where level L0 is drawn from its
switch distance on, and so on.
"""

import gc
import json
import math
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import billboards_models
import bpy
import numpy as np
from texmesh_assets import GENERATORS, JUDGING, TUNING, generate, open_asset

import billboards
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud
from farfield.addon.core.billboards.comparison import measure_difference
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.geometry.directions import from_spherical
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.job_run import run_job
from lib import environment, scene_files
from lib.baselines import build_octahedral_impostor, decimate
from lib.contact_sheet import draw_contact_sheet, enlarge, write_png
from lib.studio import Studio, bounding_sphere, open_studio

DATA = environment.ROOT.parent / "shared" / "data"
FILES = {
    "max_planck": "meshes/max_planck.obj",
    "bunny": "meshes/stanford_bunny.obj",
    "cowhead": "meshes/bff_cowhead.obj",
    "blub": "textured/blub/blub.glb",
    "leafy_tree": "trees/leafy_tree.glb",
    "pine_tree": "trees/pine_tree.glb",
    "tree": "trees/tree.glb",
    "sceaux": "sceaux/mesh_15k.ply",
}
MODELS = [*FILES, *TUNING, *JUDGING, *GENERATORS, *billboards_models.GENERATORS]
VIEWS, SAMPLES, IMPOSTOR_SAMPLES = 12, 32, 8
SUN_HEIGHTS = (math.radians(55.0), math.radians(12.0), None)  # None: the sky alone
CHAIN = (4, 8, 16, 32, 64, 128, 256)  # pixels along the longest side
CHAIN_VIEWS = 8
MARGIN = 6  # pixels around the object


@dataclass(frozen=True)
class View:
    """A direction (3,) towards the viewer, and one towards the Sun; None for the sky alone."""

    direction: np.ndarray
    sun: np.ndarray | None


def measure_ordinary(given: Namespace) -> dict[str, Any]:
    """Return the figures of every model of `given.models`; those that fail with a sentence."""
    results: dict[str, Any] = {}
    for index, name in enumerate(given.models or MODELS):
        print(f"{name} ({time.strftime('%H:%M:%S')})", file=sys.stderr, flush=True)
        try:
            results[name] = _measure(name, np.random.default_rng([given.seed, index]), given)
        except FarfieldError as error:
            results[name] = {"error": str(error)}
        gc.collect()
        print(json.dumps(results[name]), file=sys.stderr, flush=True)
    return results


def _measure(name: str, random: np.random.Generator, given: Namespace) -> dict[str, Any]:
    sources = _open(name, given.seed)
    job = billboards.prepare_input(None, BillboardSettings(), BuildOptions(combine_selected=True, keep_original_visible=True))
    start = time.perf_counter()
    run_to_end(run_job(job))
    seconds = time.perf_counter() - start
    cloud = billboards.read_built_clouds(job)[0]
    views = [_random_view(random, index) for index in range(VIEWS)]
    rows = [_compare_level(name, sources, cloud, index, views, given) for index in range(len(cloud.levels))]
    for row, level, item in zip(rows, job.built_clouds[0][1].levels, cloud.levels, strict=True):
        report = billboards.build_level_report([level], [item])
        row |= {key: report[key] for key in ("quads", "mesh_triangles", "atlas_use")}
    return {
        "source_triangles": _count_triangles(sources),
        "seconds": round(seconds, 1),
        "levels": rows,
        "chain": _measure_chain(sources, cloud, views),
        "notes": cloud.notes,
    }


def _open(name: str, seed: int) -> list[bpy.types.Object]:
    """Replace the scene by a model and return its objects."""
    if name in billboards_models.GENERATORS:
        objects = generate(billboards_models.GENERATORS, name, seed)
        bpy.context.view_layer.update()
        return objects
    if name not in FILES:
        return open_asset(DATA, name, seed)
    scene_files.open_scene(DATA / FILES[name])
    return scene_files.objects_in_renders(DATA / FILES[name])


def _random_view(random: np.random.Generator, index: int) -> View:
    """Return a view from above or slightly below the horizon, lit by the light whose turn it is."""
    height = SUN_HEIGHTS[index % len(SUN_HEIGHTS)]
    polar = math.acos(random.uniform(-0.3, 0.95))
    sun = None if height is None else from_spherical(np.array([[0.5 * math.pi - height, random.uniform(0.0, 2.0 * math.pi)]]))[0]
    return View(from_spherical(np.array([[polar, random.uniform(0.0, 2.0 * math.pi)]]))[0], sun)


def _compare_level(
    name: str, sources: Sequence[bpy.types.Object], cloud: SceneCloud, index: int, views: Sequence[View], given: Namespace
) -> dict[str, Any]:
    """Return the figures of a level and of its alternatives; write a sheet of three views if `given.sheets` is a folder."""
    level = cloud.levels[index]
    triangles, size = _count_triangles([level]), cloud.texture_bytes(index)
    row = {"error": float(level["farfield_error"]), "triangles": triangles, "bytes": size}
    shown: dict[str, Any] = {"source": list(sources), "cloud": [level]}
    others: list[Callable[[], None]] = []
    try:
        decimated = decimate(list(sources), triangles)
        shown["decimate"] = [decimated]
        others.append(lambda: bpy.data.batch_remove([decimated, decimated.data]))
    except FarfieldError as error:
        row["decimate"] = str(error)
    facing = None
    if given.impostors:
        facing = run_to_end(build_octahedral_impostor(sources, size, IMPOSTOR_SAMPLES))
        shown["impostor"] = facing.objects
        others.append(facing.remove)
    with open_studio([item for items in shown.values() for item in items], SAMPLES) as studio:
        renders = {key: [] for key in shown}
        for view in views:
            if facing is not None:
                facing.face_viewer(view.direction)
            for key, items in shown.items():
                renders[key].append(_render(studio, items, sources, view, row["error"]))
    for key in list(shown)[1:]:
        row[key] = _score(renders["source"], renders[key])
    if given.sheets is not None:
        given.sheets.mkdir(parents=True, exist_ok=True)
        _draw(given.sheets / f"{name}_L{index}.png", f"{name} L{index}: {triangles} triangles, {size} bytes", renders)
    for remove in others:
        remove()
    return row


def _render(
    studio: Studio, items: Sequence[bpy.types.Object], sources: Sequence[bpy.types.Object], view: View, pixel_size: float
) -> np.ndarray:
    """Return the render (S, S, 4) of `items`, framed for `sources`."""
    center, radius = bounding_sphere(sources)
    studio.sun.hide_render = view.sun is None
    if view.sun is not None:
        studio.set_sun_direction(view.sun)
    return studio.render(items, view.direction, center, pixel_size, math.ceil(2.0 * radius / pixel_size) + 2 * MARGIN)


def _score(sources: Sequence[np.ndarray], images: Sequence[np.ndarray]) -> dict[str, float]:
    """Return mean scores, and the smallest overlap of silhouettes."""
    difference = measure_difference(sources, images)
    overlaps = [metrics.alpha_iou(source[..., 3], image[..., 3]) for source, image in zip(sources, images, strict=True)]
    return {
        "psnr": round(difference.psnr, 2),
        "flip": round(difference.visible, 4),
        "iou": round(float(np.mean(overlaps)), 4),
        "worst_iou": round(float(np.min(overlaps)), 4),
    }


def _measure_chain(sources: Sequence[bpy.types.Object], cloud: SceneCloud, views: Sequence[View]) -> dict[str, Any]:
    """Return coverage and luminance of the level that is shown at each size of CHAIN relative to the source."""
    errors = np.array([float(level["farfield_error"]) for level in cloud.levels])
    side = 2.0 * bounding_sphere(sources)[1]
    rows = {}
    with open_studio([*sources, *cloud.levels], SAMPLES) as studio:
        for pixels in CHAIN:
            pixel_size = side / pixels
            usable = np.flatnonzero(errors <= pixel_size)
            level = int(usable[-1]) if len(usable) else 0
            pairs = [
                [_render(studio, items, sources, view, pixel_size) for items in (list(sources), [cloud.levels[level]])]
                for view in views[:CHAIN_VIEWS]
            ]
            sums = np.array([[(image[..., 3].sum(), image[..., :3].sum()) for image in pair] for pair in pairs])
            ratios = sums[:, 1] / np.maximum(sums[:, 0], 1e-9)
            worst = np.abs(ratios - 1.0).max(axis=0)
            rows[pixels] = {
                "level": level,
                "coverage": round(float(ratios[:, 0].mean()), 4),
                "luminance": round(float(ratios[:, 1].mean()), 4),
                "worst": [round(float(value), 4) for value in worst],
            }
    return rows


def _count_triangles(items: Sequence[bpy.types.Object]) -> int:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return sum(polygon.loop_total - 2 for item in items for polygon in item.evaluated_get(depsgraph).data.polygons)


def _draw(path: Path, title: str, renders: dict[str, list[np.ndarray]]) -> None:
    """Write the renders of the first view with each light."""
    factor = max(1, 240 // len(renders["source"][0]))
    rows = [[enlarge(metrics.composite_over_gray(images[view]), factor) for view in range(len(SUN_HEIGHTS))] for images in renders.values()]
    write_png(path, draw_contact_sheet(title, rows, list(renders), [["high Sun"], ["low Sun"], ["sky alone"]]))
