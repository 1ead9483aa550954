"""Measures whole chains of levels for `bench_texmesh.py`: time and memory, switches, and subset levels."""

import json
import sys
import time
from argparse import Namespace
from typing import Any

import numpy as np
import texmesh_models
from packages_views import random_directions
from texmesh_chains import TexturedModel, default_settings, make_chain, measure_cost, model_names, open_textured, paint
from texmesh_documents import draw_maps, list_documents

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_chain import LevelChain, make_levels
from farfield.addon.core.texmesh.perception.level_images import LevelImages, measure_difference
from farfield.addon.core.texmesh.perception.views import frame_around, prepare_surface
from farfield.addon.core.texmesh.rebaking.rebake import rebake_images
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import Simplification, extract_level, simplify_by_cost
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh

MAX_SECONDS, MAX_MEMORY_MB = 60.0, 2000.0
SPEED_RINGS, SPEED_SIDE = 224, 4096  # 4 x 224 x 223 = 199,808 triangles
MAX_DIFFERENCE = 0.05
VIEWS = 8  # in which switches are checked; other ones than those of the search
FRACTIONS = (0.5, 0.25, 0.1, 0.03)
MAX_MISS = 0.01  # Relative excess of a target that is reached.


def measure_speed(given: Namespace) -> dict[str, Any]:
    """Return seconds and peak memory of an analysis and levels of 200k triangles with a large texture, and of rebaking four maps of that
    size for all levels. The memory is that of the process: measure this part alone."""
    generator = np.random.default_rng(given.seed)
    mesh, texture = make_ball(SPEED_RINGS, generator), paint(SPEED_SIDE, generator)
    maps = draw_maps(texture)

    def make_all() -> tuple[LevelChain, float]:
        chain = run_to_end(make_levels(mesh, [texture], default_settings()))
        started = time.perf_counter()
        rebake_images(list_documents(chain, maps), False)
        return chain, time.perf_counter() - started

    (chain, seconds), cost = measure_cost(make_all, MAX_SECONDS, MAX_MEMORY_MB)
    levels = [len(level.mesh.triangles) for level in chain.levels]
    return {"triangles": len(mesh.triangles), **cost, "seconds_rebaking": round(seconds, 1), "levels": levels}


def measure_switching(given: Namespace) -> dict[str, Any]:
    """Return the FLIP between neighboring levels at their switch distance, in views that the search did not use."""
    results = {}
    for name in model_names(given):
        model, chain = open_textured(given.data, name, given.seed), make_chain(given.data, name, given.seed)
        results[name] = check_switches(chain, model, np.random.default_rng([given.seed, 0]))
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def check_switches(chain: LevelChain, model: TexturedModel, generator: np.random.Generator) -> dict[str, Any]:
    """Return the largest mean FLIP of each switch, in random views."""
    settings = TexmeshSettings()
    directions, mipmaps, frame = random_directions(VIEWS, generator), model.mipmaps, frame_around(chain.levels[0].mesh.vertices)
    images = [
        LevelImages(prepare_surface(level.mesh, mipmaps, settings.shaded), frame, directions, settings.pixels_per_degree)
        for level in chain.levels
    ]
    switches = []
    for number, level in enumerate(chain.levels[1:], 1):
        pixels = max(int(frame.side / level.pixel_size), 1)
        difference = measure_difference(images[number - 1], images[number], pixels, range(VIEWS))
        switches.append(
            {
                "triangles": len(level.mesh.triangles),
                "pixels": pixels,
                "difference": round(float(difference.means.max()), 4),
                "local_difference": round(float(difference.highs.max()), 4),
                "difference_of_search": round(level.switch.difference, 4),
            }
        )
    largest = max((switch["difference"] for switch in switches), default=0.0)
    return {"max_difference": MAX_DIFFERENCE, "difference": largest, "is_met": largest <= MAX_DIFFERENCE, "switches": switches}


def measure_targets(given: Namespace) -> dict[str, Any]:
    """Return whether subset levels have vertices and wedges of the original, bit for bit, and whether they reach their targets."""
    results = {}
    for name in model_names(given):
        fine = texmesh_models.open_model(given.data, name)
        targets = [max(round(fraction * len(fine.triangles)), 1) for fraction in FRACTIONS]
        simplification = run_to_end(simplify_by_cost(fine, None, targets, TexmeshSettings()))
        results[name] = {"triangles": len(fine.triangles), **check_subsets(fine, simplification, targets)}
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def check_subsets(fine: TexturedMesh, simplification: Simplification, targets: list[int]) -> dict[str, Any]:
    """Compare levels with the original by the bytes of their vertices and wedges."""
    corners = np.concatenate([fine.vertices[fine.wedge_vertices], fine.uvs], axis=1)
    known = {row.tobytes() for row in corners}
    rows = []
    for target, subset in zip(targets, simplification.levels, strict=True):
        level = extract_level(fine, subset)
        wedges = np.concatenate([level.vertices[level.wedge_vertices], level.uvs], axis=1)
        count = len(level.triangles)
        rows.append(
            {
                "target": target,
                "triangles": count,
                "is_reached": abs(count - target) <= max(MAX_MISS * target, 1.0),
                "constraint": subset.constraint,
                "is_subset": all(row.tobytes() in known for row in wedges),
            }
        )
    is_met = all(row["is_subset"] and (row["is_reached"] or row["constraint"]) for row in rows)
    return {"is_met": is_met, "levels": rows}


def make_ball(rings: int, generator: np.random.Generator) -> TexturedMesh:
    """Return a bumpy ball with longitude and latitude as texture coordinates."""
    polar, azimuth = np.meshgrid(np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1), indexing="ij")
    radii = 1.0 + 0.05 * np.sin(polar) ** 2 * sum(
        np.sin(order * azimuth + phase) * np.sin(order * polar)
        for order, phase in zip((3, 7, 19), generator.uniform(0.0, 6.0, 3), strict=True)
    )
    points = np.stack([radii * np.sin(polar) * np.cos(azimuth), radii * np.sin(polar) * np.sin(azimuth), radii * np.cos(polar)], axis=2)
    points[:, -1] = points[:, 0]
    points[[0, -1]] = points[[0, -1], :1]
    uvs = np.stack([azimuth / (2.0 * np.pi), 1.0 - polar / np.pi], axis=2)
    return grid_mesh(points, uvs)


def grid_mesh(points: np.ndarray, uvs: np.ndarray) -> TexturedMesh:
    """Return the triangles of a grid (R, C, 3) with texture coordinates (R, C, 2); equal points become one vertex."""
    rows, columns = points.shape[:2]
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    a, b, c, d = first, first + columns, first + columns + 1, first + 1
    corners = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)])[:, ::-1]
    vertices, inverse = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
    triangles = inverse.reshape(-1)[corners]
    is_proper = (np.sort(triangles, axis=1)[:, 1:] != np.sort(triangles, axis=1)[:, :-1]).all(axis=1)
    mesh = TriangleMesh(vertices, triangles[is_proper].astype(np.int32))
    return build_textured_mesh(mesh, uvs.reshape(-1, 2)[corners[is_proper]])
