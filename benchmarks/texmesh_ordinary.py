"""Ordinary assets for `bench_texmesh.py`: levels by default settings compared with those of other programs, all with whole materials.

Levels have 50, 25, 10 and 3 % of the triangles of each object with at least MIN_TRIANGLES. The others are Blender's Decimate, gltfpack with
`-si`, and pymeshlab's quadric edge collapse, with texture where there is a UV map. All get the same targets; one that misses a target by
more than MAX_PEER_MISS is not compared with. Models of texmesh_assets.TUNING are measured but not judged.

- Texture: mean and 99th percentile of the distances between points of equal texture coordinates, see texmesh_equal_uvs.
- Surface: the largest distance of samples and vertices of one surface from the other one.
- FLIP, with --flip: see texmesh_asset_renders.

Distances are those of the worse one of both ways, in % of the diagonal of the objects with levels, which count by their area. Ratios are
Farfield's to the best of the others, also those of the object where it is largest; distances below FLOORS are no distances. At 1 % only the
triangles are compared with the target.
"""

import json
import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import texmesh_asset_renders
from texmesh_asset_levels import Asset, add_farfield_levels, add_peer_levels, find_assets, find_points, read_surface
from texmesh_assets import GENERATORS, JUDGING, TUNING, open_asset
from texmesh_equal_uvs import MeasuredSurface, TextureDistances, measure_largest, measure_texture

from farfield.addon.core.errors import FarfieldError

RATIOS = (0.5, 0.25, 0.1, 0.03)
SMALLEST_RATIO = 0.01
MIN_TRIANGLES = 100
PEERS = ("decimate", "gltfpack", "pymeshlab")
METHODS = ("farfield", *PEERS)
MAX_MISS, MAX_PEER_MISS = 0.01, 0.05  # Relative to the target; one triangle is no miss.
SAMPLES, MIN_SAMPLES = 30_000, 1_500  # Of a model, and at least of an object.
QUANTILE = 0.99
FLOORS = {"mean": 1e-5, "p99": 1e-4, "largest": 1e-4, "flip": 1e-4}  # Distances relative to the diagonal: 0.003 and 0.03 of 256 pixels.
MAX_TEXTURE_RATIO, MAX_RATIO, MAX_SURFACE_RATIO, MAX_FLIP_RATIO = 0.7, 1.0, 1.3, 1.1
SURFACE_FRACTION, FLIP_FRACTION = 0.9, 0.95


@dataclass(frozen=True, eq=False)
class Measured:
    """A level of an object.

    Attributes:
        triangles: their number.
        texture: from the original and from the level; None without UV map.
        areas: of both surfaces, times the objects that share the mesh.
        largest: the largest distance between both surfaces.
    """

    triangles: int
    texture: tuple[TextureDistances, TextureDistances] | None
    areas: tuple[float, float]
    largest: float


def measure_ordinary(given: Namespace) -> dict[str, Any]:
    """Return the figures of all models, and which bounds they meet."""
    names = given.models or [*TUNING, *JUDGING, *GENERATORS]
    results = {}
    for name in names:
        try:
            results[name] = {"is_judged": name not in TUNING, **measure_model(given, name)}
        except FarfieldError as error:
            results[name] = {"is_judged": name not in TUNING, "failure": str(error)}
        print(name, json.dumps(results[name]), file=sys.stderr)
    return {"verdicts": judge({name: result for name, result in results.items() if result["is_judged"]}), "models": results}


def measure_model(given: Namespace, name: str) -> dict[str, Any]:
    """Return the figures of one model."""
    objects = open_asset(given.data, name, given.seed)
    assets = find_assets(objects, MIN_TRIANGLES)
    result: dict[str, Any] = {"objects": len(objects), "meshes": len(assets), "triangles": sum(asset.triangles for asset in assets)}
    if not assets:
        return {**result, "summary": f"no object has {MIN_TRIANGLES} triangles"}
    started = time.perf_counter()
    result["summary"] = add_farfield_levels(assets, (*RATIOS, SMALLEST_RATIO))
    result["seconds"] = round(time.perf_counter() - started, 1)
    for asset in assets:
        add_peer_levels(asset, RATIOS)
    diagonal = float(np.linalg.norm(np.ptp(find_points(assets), axis=0)))
    result["levels"] = measure_levels(assets, diagonal)
    result["targets"] = {f"{ratio:.0%}": check_targets(assets, ratio) for ratio in (*RATIOS, SMALLEST_RATIO)}
    if given.flip or given.pictures:
        texmesh_asset_renders.add_renders(given, name, assets, result["levels"])
        for row in result["levels"].values() if given.flip else ():
            row["ratios"]["flip"] = compare({method: row["methods"][method].get("flip") for method in row["methods"]}, row, FLOORS["flip"])
    return result


def measure_levels(assets: Sequence[Asset], diagonal: float) -> dict[str, Any]:
    """Return the figures of all levels, of the model and of its worst objects."""
    surfaces = [read_surface(asset.mesh, asset.uv_map, asset.matrix) for asset in assets]
    originals = [MeasuredSurface(surface, 0) for surface in surfaces]
    total = sum(original.area for original in originals)
    counts = [max(round(SAMPLES * original.area / total), MIN_SAMPLES) for original in originals]
    rows: dict[str, Any] = {f"{ratio:.0%}": {} for ratio in RATIOS}
    measured: dict[tuple[str, float], list[Measured | None]] = {(method, ratio): [] for method in METHODS for ratio in RATIOS}
    for asset, surface, count in zip(assets, surfaces, counts, strict=True):
        original = MeasuredSurface(surface, count)
        for method, ratio in measured:
            measured[method, ratio].append(measure_level(asset, original, method, ratio))
    for ratio in RATIOS:
        targets = [max(round(ratio * asset.triangles), 1) for asset in assets]
        row: dict[str, Any] = {"target": sum(targets), "methods": {}}
        for method in METHODS:
            levels = measured[method, ratio]
            failed = [asset.failures.get((method, ratio), "") for asset, level in zip(assets, levels, strict=True) if level is None]
            row["methods"][method] = summarize(levels, diagonal) if not failed else {"failures": sorted(set(failed))}
        row["ratios"] = compare_measures(row)
        row["worst"] = find_worst([asset.item.name for asset in assets], targets, {m: measured[m, ratio] for m in METHODS}, diagonal)
        rows[f"{ratio:.0%}"] = row
    return rows


def measure_level(asset: Asset, original: MeasuredSurface, method: str, ratio: float) -> Measured | None:
    """Compare a level with the original surface; None if there is no level."""
    surface = asset.surfaces.get((method, ratio))
    if surface is None:
        return None
    level, users = MeasuredSurface(surface, original.count), len(asset.users)
    texture = (measure_texture(original, level), measure_texture(level, original)) if asset.uv_map else None
    return Measured(len(surface.triangles), texture, (users * original.area, users * level.area), measure_largest(original, level))


def summarize(levels: Sequence[Measured | None], diagonal: float) -> dict[str, Any]:
    """Return the figures of levels of several objects together, distances in % of the diagonal."""
    result: dict[str, Any] = {"triangles": sum(level.triangles for level in levels)}
    textured = [level for level in levels if level.texture is not None]
    if textured:
        ways = [_pool(textured, way) for way in range(2)]
        mean, p99, lost = (max(values) for values in zip(*ways, strict=True))
        result |= {"mean": _percent(mean / diagonal), "p99": _percent(p99 / diagonal), "lost": _percent(lost)}
    return {**result, "largest": _percent(max(level.largest for level in levels) / diagonal)}


def _pool(levels: Sequence[Measured], way: int) -> tuple[float, float, float]:
    """Return the mean, the percentile, and the fraction of lost samples, by area: from the original, or from the level (`way` 0 or 1)."""
    distances = np.concatenate([level.texture[way].distances for level in levels])
    is_lost = np.concatenate([level.texture[way].is_lost for level in levels])
    weights = np.concatenate(
        [np.full(len(level.texture[way].distances), level.areas[way] / max(len(level.texture[way].distances), 1)) for level in levels]
    )
    order = np.argsort(distances)
    reached = np.cumsum(weights[order]) / weights.sum()
    quantile = distances[order[min(np.searchsorted(reached, QUANTILE), len(order) - 1)]]
    return float(np.average(distances, weights=weights)), float(quantile), float(np.average(is_lost, weights=weights))


def _percent(fraction: float) -> float:
    return round(100.0 * fraction, 4)


def compare_measures(row: dict[str, Any]) -> dict[str, Any]:
    """Return the ratios of all distances of a row to the best of the others."""
    measures = ("mean", "p99", "largest")
    return {
        measure: compare({method: figures.get(measure) for method, figures in row["methods"].items()}, row, 100.0 * FLOORS[measure])
        for measure in measures
    }


def compare(values: dict[str, float | None], row: dict[str, Any], floor: float) -> dict[str, Any] | None:
    """Return the best of the others that reach the target of a row, and the ratio to it; None if there is nothing to compare."""
    peers = {
        name: value
        for name, value in values.items()
        if name != "farfield" and value is not None and _misses(row["methods"][name]["triangles"], row["target"]) <= MAX_PEER_MISS
    }
    if values["farfield"] is None or not peers:
        return None
    best = min(peers, key=lambda name: peers[name])
    return {"best": best, "ratio": round(values["farfield"] / max(peers[best], floor), 3)}


def _misses(count: int, target: int) -> float:
    """Return by which fraction of the target a number of triangles differs from it; 0 if by one triangle."""
    return 0.0 if abs(count - target) <= 1 else abs(count - target) / target


def find_worst(
    names: Sequence[str], targets: Sequence[int], measured: dict[str, list[Measured | None]], diagonal: float
) -> dict[str, dict[str, Any]]:
    """Return by measure the object with the largest ratio."""
    worst: dict[str, dict[str, Any]] = {}
    for index, (name, target) in enumerate(zip(names, targets, strict=True)):
        methods = {method: summarize([levels[index]], diagonal) for method, levels in measured.items() if levels[index] is not None}
        if "farfield" not in methods:
            continue
        for measure, found in compare_measures({"target": target, "methods": methods}).items():
            if found is not None and found["ratio"] > worst.get(measure, {"ratio": -1.0})["ratio"]:
                values = {method: [figures["triangles"], figures[measure]] for method, figures in methods.items()}
                worst[measure] = {"object": name, **found, "target": target, "triangles_and_values": values}
    return worst


def check_targets(assets: Sequence[Asset], ratio: float) -> dict[str, Any]:
    """Return the triangles of Farfield's levels, the target, and the objects that miss theirs."""
    counts = [len(asset.surfaces["farfield", ratio].triangles) if ("farfield", ratio) in asset.surfaces else -1 for asset in assets]
    targets = [max(round(ratio * asset.triangles), 1) for asset in assets]
    rows = zip(assets, counts, targets, strict=True)
    missed = {asset.item.name: [count, target] for asset, count, target in rows if count < 0 or _misses(count, target) > MAX_MISS}
    return {"triangles": sum(counts), "target": sum(targets), "is_reached": not missed, "missed": missed}


def judge(results: dict[str, Any]) -> dict[str, Any]:
    """Return by bound whether the models meet it, and where they do not."""
    rows = {f"{name} {label}": row for name, result in results.items() for label, row in result.get("levels", {}).items()}
    ratios = {
        measure: {place: row["ratios"][measure]["ratio"] for place, row in rows.items() if row["ratios"].get(measure) is not None}
        for measure in FLOORS
    }
    missed = {f"{name} {label}": row for name, result in results.items() for label, row in result.get("targets", {}).items()}
    missed = {place: [row["triangles"], row["target"]] for place, row in missed.items() if not row["is_reached"]}
    return {
        "texture_mean": _judge_ratios(ratios["mean"], MAX_TEXTURE_RATIO, 1.0, MAX_TEXTURE_RATIO),
        "texture_mean_above_1": _judge_ratios(ratios["mean"], MAX_RATIO, 1.0, MAX_RATIO),
        "texture_p99": _judge_ratios(ratios["p99"], MAX_RATIO, 1.0, MAX_RATIO),
        "largest": _judge_ratios(ratios["largest"], MAX_RATIO, SURFACE_FRACTION, MAX_SURFACE_RATIO),
        "flip": _judge_ratios(ratios["flip"], MAX_RATIO, FLIP_FRACTION, MAX_FLIP_RATIO),
        "targets": {"is_met": not missed, "missed": missed},
        "failures": {name: result["failure"] for name, result in results.items() if "failure" in result},
    }


def _judge_ratios(ratios: dict[str, float], bound: float, min_fraction: float, max_ratio: float) -> dict[str, Any]:
    """Return the fraction of `ratios` within `bound`, the largest, and those above `max_ratio`, in descending order."""
    if not ratios:
        return {"levels": 0, "is_met": None}
    fraction = sum(ratio <= bound for ratio in ratios.values()) / len(ratios)
    above = dict(sorted(((place, ratio) for place, ratio in ratios.items() if ratio > max_ratio), key=lambda item: -item[1]))
    is_met = fraction >= min_fraction and not above
    return {"levels": len(ratios), "fraction": round(fraction, 3), "max_ratio": max(ratios.values()), "is_met": is_met, "above": above}
