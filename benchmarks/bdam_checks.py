"""Correctness of terrain on random views, for `bench_bdam.py`: cracks and screen error."""

from argparse import Namespace
from typing import Any

import numpy as np
from bdam_stores import Workplace, build_cut_mesh, build_store
from bdam_terrains import CELL_SIZE, FractalTerrain
from bdam_views import draw_viewer, project_displacements, sample_positions

from farfield.addon.core.arrays import concatenate_ranges
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.cut_meshes import CutMesh, PatchMesh
from farfield.addon.core.bdam.view.extraction import CutSettings, extract_cut

SECOND_SHAPE = (0.55, 0.8)  # rows and columns of the second terrain of a scene, as parts of those of the first
TOLERANCES = (0.5, 1.0, 4.0)  # pixels
TOLERANCE_SLACK = 1e-6  # pixels, of rounding


def measure_cracks(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Count faults of the cuts of random cameras with random exaggerations, tolerances and culling, of two terrains in one scene."""
    random = np.random.default_rng([given.seed, 40])
    size = min(given.size, 1025)
    terrains = [FractalTerrain(size, given.seed).read_all()]
    rows, columns = (int(part * size) for part in SECOND_SHAPE)
    terrains.append(FractalTerrain(size, given.seed + 1, 0.75).read_all()[:rows, :columns])
    stores = [build_store(workplace, f"fractal-{size}", terrains[0], CELL_SIZE), build_store(workplace, "second", terrains[1], CELL_SIZE)]
    caches = [PatchCache(store) for store in stores]
    faults = dict.fromkeys(("edges_without_partner", "edges_used_twice", "vertices_that_differ", "normals_that_differ", "cells_missing"), 0)
    figures: dict[str, Any] = {"size": size, "second": [rows, columns], "cameras": given.cameras, "patches": 0, "triangles": 0}
    for _ in range(given.cameras):
        exaggeration = float(np.exp(random.uniform(np.log(0.25), np.log(8.0))))
        settings = CutSettings(float(random.choice(TOLERANCES)), exaggeration, bool(random.integers(2)))
        viewer = draw_viewer(random, stores[0], terrains[0], exaggeration)
        for store, cache in zip(stores, caches, strict=True):
            cut = extract_cut(store, viewer, settings)
            meshes = [cache.read(key) for key in cut.list_patches()]
            figures["patches"] += len(meshes)
            figures["triangles"] += sum(len(mesh.triangles) for mesh in meshes)
            for name, count in count_faults(meshes, store.header.rows, store.header.columns).items():
                faults[name] += count
    for store in stores:
        store.close()
    return figures | {"faults": faults, "bound": 0}


def count_faults(meshes: list[PatchMesh], rows: int, columns: int) -> dict[str, int]:
    """Return the number of faults of each kind where patches without holes are welded by the numbers of their vertices."""
    ids = np.concatenate([mesh.ids for mesh in meshes]).astype(np.int64)
    order = np.argsort(ids, kind="stable")
    is_same = np.append(False, ids[order][1:] == ids[order][:-1])
    differ = {}
    for name, arrays in (("vertices_that_differ", "positions"), ("normals_that_differ", "normals")):
        values = np.concatenate([getattr(mesh, arrays) for mesh in meshes])[order]
        differ[name] = int((values[1:] != values[:-1]).any(axis=1)[is_same[1:]].sum())
    triangles = np.concatenate([mesh.ids[mesh.triangles] for mesh in meshes]).astype(np.int64)
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    count = rows * columns
    forward, backward = start * count + end, end * count + start
    alone = ~np.isin(forward, backward)
    (y0, x0), (y1, x1) = divmod(start[alone], columns), divmod(end[alone], columns)
    on_border = ((x0 == x1) & ((x0 == 0) | (x0 == columns - 1))) | ((y0 == y1) & ((y0 == 0) | (y0 == rows - 1)))
    y, x = divmod(triangles, columns)
    area = ((x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (y[:, 1] - y[:, 0]) * (x[:, 2] - x[:, 0])).sum()
    return differ | {
        "edges_without_partner": int((~on_border).sum()),
        "edges_used_twice": len(forward) - len(np.unique(forward)),
        "cells_missing": abs(int(area) // 2 - (rows - 1) * (columns - 1)),
    }


def measure_screen_error(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure how far the images of all samples in the view move if the cut replaces the full terrain. Hidden samples count, too."""
    random = np.random.default_rng([given.seed, 50])
    size = min(given.size, 1025)
    heights = FractalTerrain(size, given.seed).read_all()
    figures: dict[str, Any] = {
        "size": size,
        "views": given.views,
        "samples": 0,
        "within": 0,
        "largest_px": 0.0,
        "largest_over_tolerance": 0.0,
    }
    with build_store(workplace, f"fractal-{size}", heights, CELL_SIZE) as store:
        cache, positions = PatchCache(store), sample_positions(store, heights)
        for _ in range(given.views):
            exaggeration = float(np.exp(random.uniform(np.log(0.5), np.log(4.0))))
            viewer = draw_viewer(random, store, heights, exaggeration)
            scaled = positions * [1.0, 1.0, exaggeration]
            for culls in (False, True):
                tolerance = float(random.choice(TOLERANCES))
                mesh = build_cut_mesh(cache, extract_cut(store, viewer, CutSettings(tolerance, exaggeration, culls)))
                shown = exaggeration * interpolate_heights(mesh, heights.shape).ravel()
                distances, is_visible = project_displacements(viewer, scaled, shown)
                distances = distances[is_visible]
                figures["samples"] += len(distances)
                figures["within"] += int((distances <= tolerance + TOLERANCE_SLACK).sum())
                if len(distances):
                    figures["largest_px"] = max(figures["largest_px"], round(float(distances.max()), 4))
                    ratio = round(float(distances.max()) / tolerance, 4)
                    figures["largest_over_tolerance"] = max(figures["largest_over_tolerance"], ratio)
    return figures | {"fraction_within": figures["within"] / max(figures["samples"], 1), "bound": 1.0}


def interpolate_heights(mesh: CutMesh, shape: tuple[int, int]) -> np.ndarray:
    """Return the heights (H, W) float64 of a mesh at all samples of the field."""
    y, x = divmod(mesh.ids[mesh.triangles], shape[1])
    (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = x.T, y.T, mesh.positions[:, 2][mesh.triangles].T
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    gradient_x = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / area
    gradient_y = ((z2 - z0) * (x1 - x0) - (z1 - z0) * (x2 - x0)) / area
    counts = y.max(axis=1) - y.min(axis=1) + 1
    of_triangle, row = np.repeat(np.arange(len(y)), counts), concatenate_ranges(y.min(axis=1), counts)
    left, right = np.zeros(len(row), np.int64), np.full(len(row), shape[1] - 1)
    for start, end in ((0, 1), (1, 2), (2, 0)):  # exact in integers: a sample on an edge belongs to both triangles
        dx, dy = (x[of_triangle, end] - x[of_triangle, start]), (y[of_triangle, end] - y[of_triangle, start])
        crossing = x[of_triangle, start] * dy + (row - y[of_triangle, start]) * dx  # times dy
        divisor = np.where(dy == 0, 1, dy)
        left = np.where(dy < 0, np.maximum(left, -(-crossing // divisor)), left)
        right = np.where(dy > 0, np.minimum(right, crossing // divisor), right)
    lengths = np.maximum(right - left + 1, 0)
    column, row, of_triangle = concatenate_ranges(left, lengths), np.repeat(row, lengths), np.repeat(of_triangle, lengths)
    heights = np.full(shape, np.nan)
    dx, dy = column - x0[of_triangle], row - y0[of_triangle]
    heights[row, column] = z0[of_triangle] + gradient_x[of_triangle] * dx + gradient_y[of_triangle] * dy
    return heights
