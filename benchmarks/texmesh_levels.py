"""Measures whole chains of levels for `bench_texmesh.py`: time and memory, switches, subset levels, and the figures of the paper."""

import json
import sys
import time
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import texmesh_models
from PIL import Image

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.imaging.mipmaps import build_mipmaps, resize_by_area
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_chain import AllSettings, LevelChain, make_levels
from farfield.addon.core.texmesh.perception.level_images import LevelImages, measure_difference
from farfield.addon.core.texmesh.perception.settings import PerceptionSettings
from farfield.addon.core.texmesh.perception.views import frame_around, prepare_surface
from farfield.addon.core.texmesh.scale_space.analysis import analyze_scale_space
from farfield.addon.core.texmesh.scale_space.settings import ScaleSpaceSettings
from farfield.addon.core.texmesh.settings import LevelSettings
from farfield.addon.core.texmesh.simplification.levels import Simplification, extract_level, simplify_by_cost
from farfield.addon.core.texmesh.simplification.settings import SimplificationSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from lib import command_line

MAX_SECONDS, MAX_MEMORY_MB = 40.0, 2000.0
SPEED_RINGS, SPEED_SIDE = 224, 4096  # 4 x 224 x 223 = 199,808 triangles
SPOT_TEXTURE = "textured/spot/spot_texture.png"
TEXTURE_SIDE = 512
MAX_DIFFERENCE = 0.05
VIEWS = 8  # in which switches are checked; other ones than those of the search
FRACTIONS = (0.5, 0.25, 0.1, 0.03)
MAX_MISS = 0.01  # of a target that is reached
PAPER_COUNTS = (1872, 1194, 1135, 1055, 893, 676)  # vertices of the head in Figure 4; those between the first and the last from their faces
HEAD_COLUMNS, HEAD_ROWS = 36, 52
HEAD_PARTS = (  # angle, height, widths, and height of a bump on the head: nose, eyes, brow, mouth, chin, ears
    (0.0, 0.0, 0.14, 0.16, 0.25),
    (0.32, 0.14, 0.13, 0.07, -0.06),
    (-0.32, 0.14, 0.13, 0.07, -0.06),
    (0.0, 0.28, 0.6, 0.06, 0.05),
    (0.0, -0.26, 0.22, 0.04, 0.05),
    (0.0, -0.48, 0.25, 0.1, 0.1),
    (1.55, 0.05, 0.1, 0.16, 0.16),
    (-1.55, 0.05, 0.1, 0.16, 0.16),
)


def measure_speed(given: Namespace) -> dict[str, Any]:
    """Return seconds and peak memory of an analysis and levels of 200k triangles with a large texture. The memory is that of the process:
    measure this part alone."""
    generator = np.random.default_rng(given.seed)
    mesh, texture = make_ball(SPEED_RINGS, generator), paint(SPEED_SIDE, generator)
    before = command_line.peak_memory_mb()
    started, cpu_started = time.perf_counter(), time.process_time()
    chain = run_to_end(make_levels(mesh, [texture], default_settings()))
    return {
        "triangles": len(mesh.triangles),
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(time.process_time() - cpu_started, 1),
        "max_seconds": MAX_SECONDS,
        "peak_memory_mb": round(command_line.peak_memory_mb()),
        "peak_memory_before_mb": round(before),
        "max_memory_mb": MAX_MEMORY_MB,
        "levels": [len(level.mesh.triangles) for level in chain.levels],
    }


def measure_switching(given: Namespace) -> dict[str, Any]:
    """Return the FLIP between neighboring levels at their switch distance, in views that the search did not use."""
    results = {}
    for name in model_names(given):
        generator = np.random.default_rng(given.seed)
        mesh, textures = open_textured(given.data, name, generator)
        chain = run_to_end(make_levels(mesh, textures, default_settings(), name))
        results[name] = check_switches(chain, textures, generator)
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def check_switches(chain: LevelChain, textures: list[np.ndarray], generator: np.random.Generator) -> dict[str, Any]:
    """Return the largest mean FLIP of each switch, in random views."""
    settings = PerceptionSettings()
    directions = generator.normal(size=(VIEWS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    mipmaps, frame = [build_mipmaps(texture) for texture in textures], frame_around(chain.levels[0].mesh.vertices)
    images = [
        LevelImages(prepare_surface(level.mesh, mipmaps, settings.is_lit), frame, directions, settings.pixels_per_degree)
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
        simplification = run_to_end(simplify_by_cost(fine, None, targets, SimplificationSettings()))
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


def measure_paper(given: Namespace) -> dict[str, Any]:
    """Return vertices per scale (Figure 4), ranges (Figure 10) and pixel sizes of all levels (Figure 11) of a head like the paper's."""
    generator = np.random.default_rng(given.seed)
    head, texture = make_head(generator), paint(TEXTURE_SIDE, generator)
    results: dict[str, Any] = {"vertices_of_figure_4": PAPER_COUNTS}
    for mode in ("paper", "surface"):
        scale_map = run_to_end(analyze_scale_space(head, [texture], ScaleSpaceSettings(mode=mode)))
        counts, ranges = scale_map.counts.tolist(), np.round(scale_map.ranges, 3).tolist()
        results[mode] = {"features": counts, "ranges": ranges, "losses": scale_map.losses}
    settings = AllSettings(
        LevelSettings(product="subset", order="scale"), ScaleSpaceSettings(mode="paper"), SimplificationSettings(), PerceptionSettings()
    )
    chain = run_to_end(make_levels(head, [texture], settings))
    results["steps_of_figure_11"] = [{"triangles": count, "pixel_size": round(size, 5)} for count, size in chain.candidates]
    results["weber_fractions"] = np.round(chain.impacts.fractions, 4).tolist()
    results["levels"] = [
        {"triangles": len(level.mesh.triangles), "scale": level.scale, "switch": None if level.switch is None else asdict(level.switch)}
        for level in chain.levels
    ]
    return results


def default_settings() -> AllSettings:
    """Return the default settings."""
    return AllSettings(LevelSettings(), ScaleSpaceSettings(), SimplificationSettings(), PerceptionSettings())


def model_names(given: Namespace) -> list[str]:
    """Return the models that were asked for, or all, generated ones by the seed."""
    generated = [f"{kind}:{given.seed + index}" for index, kind in enumerate(texmesh_models.GENERATORS)]
    return given.models or [*texmesh_models.REAL_MODELS, "bunny", *generated]


def open_textured(data: Path, name: str, generator: np.random.Generator) -> tuple[TexturedMesh, list[np.ndarray]]:
    """Return a model and a texture per material: its own one for spot, painted ones for the others."""
    mesh = texmesh_models.open_model(data, name)
    if name == "spot":
        with Image.open(data / SPOT_TEXTURE) as image:
            encoded = np.asarray(image.convert("RGB"))[::-1].astype(np.float32) / 255.0
        return mesh, [(encoded**2.2).astype(np.float32)]
    return mesh, [paint(TEXTURE_SIDE, generator) for _ in range(int(mesh.materials.max()) + 1)]


def paint(side: int, generator: np.random.Generator) -> np.ndarray:
    """Return an image (side, side, 3) of soft spots of several sizes in two colors, linear."""
    total = np.zeros((side, side), np.float32)
    for cells in (8, 32, 128):
        coarse = generator.random((cells, cells, 1)).astype(np.float32)
        total += resize_by_area(np.repeat(np.repeat(coarse, side // cells, axis=0), side // cells, axis=1), side)[..., 0] / 3.0
    colors = generator.uniform(0.05, 0.9, (2, 3)).astype(np.float32)
    weights = np.clip(3.0 * total - 1.0, 0.0, 1.0)[..., None]
    return colors[0] + weights * (colors[1] - colors[0])


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


def make_head(generator: np.random.Generator) -> TexturedMesh:
    """Return a star-shaped head on the grid of the paper's: 36 angles and 52 heights without caps, with noise of 0.3 %."""
    height, angle = np.meshgrid(np.linspace(-0.8, 0.8, HEAD_ROWS), np.linspace(-np.pi, np.pi, HEAD_COLUMNS + 1), indexing="ij")
    radius = 0.7 * np.sqrt(np.maximum(1.0 - height**2, 0.0)) * (1.0 + 0.12 * np.cos(angle))
    for place, level, width, extent, size in HEAD_PARTS:
        turn = np.angle(np.exp(1j * (angle - place)))
        radius += size * np.exp(-((turn / width) ** 2) - ((height - level) / extent) ** 2)
    radius *= 1.0 + 0.003 * generator.normal(size=radius.shape)
    radius[:, -1] = radius[:, 0]
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 1.2 * height], axis=2)
    points[:, -1] = points[:, 0]
    return grid_mesh(points, np.stack([angle / (2.0 * np.pi) + 0.5, 0.5 * (height + 1.0)], axis=2))


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
