"""Compares the tool with the figures of the paper, for `bench_texmesh.py`: vertices per scale (Figure 4), convergence (Figure 10), and the
distance by scale (Figure 11).

The models of the paper are not published. Generated star-shaped bodies with the same number of samples stand for them.
"""

from argparse import Namespace
from collections.abc import Callable
from typing import Any

import numpy as np
from texmesh_chains import PAINTED_SIDE, paint
from texmesh_levels import grid_mesh

from farfield.addon.core.imaging.mipmaps import build_mipmaps
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_choices import find_red_refinements, find_zones
from farfield.addon.core.texmesh.perception.switch_distances import find_switches
from farfield.addon.core.texmesh.perception.views import frame_around, prepare_surface
from farfield.addon.core.texmesh.scale_space.analysis import analyze_scale_space
from farfield.addon.core.texmesh.scale_space.features import ScaleMap
from farfield.addon.core.texmesh.settings import AnalysisSettings, TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import extract_level, simplify_in_order
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

PAPER_COUNTS = (1872, 1194, 1135, 1055, 893, 676)  # vertices of the head in Figure 4; those between the first and the last from their faces
COLUMNS, ROWS = 36, 52  # angles and heights of the head in Figure 4
DENSITY = 2  # Density of the dense bodies of Figure 10 relative to the simplified ones, along both directions.
NOISE = 0.003  # Relative to the radius.
BUMPS_OF_HEAD = (  # angle, height, widths, and height of a bump on the head: nose, eyes, brow, mouth, chin, ears
    (0.0, 0.0, 0.14, 0.16, 0.25),
    (0.32, 0.14, 0.13, 0.07, -0.06),
    (-0.32, 0.14, 0.13, 0.07, -0.06),
    (0.0, 0.28, 0.6, 0.06, 0.05),
    (0.0, -0.26, 0.22, 0.04, 0.05),
    (0.0, -0.48, 0.25, 0.1, 0.1),
    (1.55, 0.05, 0.1, 0.16, 0.16),
    (-1.55, 0.05, 0.1, 0.16, 0.16),
)
BUMPS_OF_NUTCRACKER = (  # jaw, nose, beard, two arms, two boots, hilt
    (0.0, 0.3, 0.3, 0.05, 0.09),
    (0.0, 0.4, 0.1, 0.05, 0.12),
    (0.0, 0.2, 0.35, 0.07, 0.06),
    (1.6, -0.05, 0.25, 0.2, 0.15),
    (-1.6, -0.05, 0.25, 0.2, 0.15),
    (0.5, -0.72, 0.35, 0.06, 0.14),
    (-0.5, -0.72, 0.35, 0.06, 0.14),
    (1.1, -0.3, 0.08, 0.15, 0.1),
)
Profile = Callable[[np.ndarray, np.ndarray], np.ndarray]


def measure_paper(given: Namespace) -> dict[str, Any]:
    """Return the figures of a head like that of the paper, of a nutcracker and of a vase."""
    texture = paint(PAINTED_SIDE, np.random.default_rng(given.seed))
    bodies = {name: make_body(name, np.random.default_rng([given.seed, 2])) for name in PROFILES}
    maps = {
        (name, mode): run_to_end(analyze_scale_space(body, [texture], AnalysisSettings(analysis=mode)))
        for name, body in bodies.items()
        for mode in ("paper", "surface")
    }
    features = {f"{name}, {mode}": scale_map.counts.tolist() for (name, mode), scale_map in maps.items()}
    return {
        "vertices_of_figure_4": PAPER_COUNTS,
        "figure_4": features,
        "figure_10": {f"{name}, {mode}": np.round(scale_map.ranges, 3).tolist() for (name, mode), scale_map in maps.items()},
        "convergence": measure_convergence(given.seed, texture),
        "figure_11": {name: measure_distances(body, maps[name, "paper"], texture) for name, body in bodies.items()},
    }


def measure_convergence(seed: int, texture: np.ndarray) -> dict[str, Any]:
    """Return the last standard deviation, in mean samples and relative to the height, of dense and of simplified bodies (Figure 10)."""
    results = {}
    for name in PROFILES:
        for density in (DENSITY, 1):
            body = make_body(name, np.random.default_rng([seed, 2]), density)
            scale_map = run_to_end(analyze_scale_space(body, [texture], AnalysisSettings(analysis="range_image")))
            sigma = float(scale_map.sigmas[-1])
            height = float(np.ptp(body.vertices[:, 2]))
            spacing = height / (density * ROWS - 1)
            results[f"{name}, {'dense' if density > 1 else 'simplified'}"] = {
                "samples": len(body.vertices),
                "row_spacings": round(sigma / spacing, 2),
                "height_fraction": round(sigma / height, 3),
            }
    return results


def measure_distances(body: TexturedMesh, scale_map: ScaleMap, texture: np.ndarray) -> dict[str, Any]:
    """Return, for each scale from 1 on, the triangles, the nearest distance in heights of the body at which it looks like the original, and
    the zones of imperceptible refinements (Figure 11)."""
    settings, mipmaps = TexmeshSettings(), [build_mipmaps(texture)]
    total, vertices = len(body.triangles), len(body.vertices)
    targets = np.minimum.accumulate([max(total - 2 * (vertices - int(count)), 1) for count in scale_map.counts[1:]]).tolist()
    rank = np.argsort(np.argsort(scale_map.strengths, kind="stable"), kind="stable") / vertices
    simplified = run_to_end(simplify_in_order(body, scale_map.last_scales + rank, targets, TexmeshSettings()))
    fine = prepare_surface(body, mipmaps, settings.shaded)
    levels = [extract_level(body, level) for level in simplified.levels]
    switches = [run_to_end(find_switches([fine, prepare_surface(level, mipmaps, settings.shaded)], settings))[0] for level in levels]
    height, growth = float(np.ptp(body.vertices[:, 2])), np.tan(np.radians(1.0 / settings.pixels_per_degree))
    distances = np.array([switch.pixel_size / growth / height for switch in switches])
    nearest = np.maximum.accumulate(np.concatenate([[0.0], distances]))
    return {
        "triangles": [len(level.triangles) for level in levels],
        "pixels": [round(frame_around(body.vertices).side / switch.pixel_size) for switch in switches],
        "distances": np.round(distances, 2).tolist(),
        "zones": find_zones(find_red_refinements(nearest)),
    }


def make_body(name: str, generator: np.random.Generator, density: int = 1) -> TexturedMesh:
    """Return a star-shaped body with one of PROFILES on a grid of angles and heights without caps, with noise."""
    rows, columns = density * ROWS, density * COLUMNS
    height, angle = np.meshgrid(np.linspace(-0.8, 0.8, rows), np.linspace(-np.pi, np.pi, columns + 1), indexing="ij")
    radius = PROFILES[name](height, angle) * (1.0 + NOISE * generator.normal(size=height.shape))
    radius[:, -1] = radius[:, 0]
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 1.2 * height], axis=2)
    points[:, -1] = points[:, 0]
    return grid_mesh(points, np.stack([angle / (2.0 * np.pi) + 0.5, 0.5 * (height + 1.0)], axis=2))


def shape_head(height: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the radius of a head."""
    round_part = 0.7 * np.sqrt(np.maximum(1.0 - height**2, 0.0)) * (1.0 + 0.12 * np.cos(angle))
    return round_part + _add_bumps(height, angle, BUMPS_OF_HEAD)


def shape_nutcracker(height: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the radius of a figure of turned wood: base, legs, body, head and hat, with steps between them."""
    steps = np.array([-0.7, -0.35, 0.15, 0.5])
    radii = np.array([0.5, 0.3, 0.42, 0.3, 0.36])
    turned = radii[0] + sum((radii[index + 1] - radii[index]) / (1.0 + np.exp((step - height) / 0.01)) for index, step in enumerate(steps))
    return turned + _add_bumps(height, angle, BUMPS_OF_NUTCRACKER)


def shape_vase(height: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the radius of a vase with grooves."""
    return 0.4 + 0.18 * np.sin(3.2 * height + 0.6) + 0.012 * np.cos(12.0 * angle) * np.exp(-((height / 0.4) ** 2))


def _add_bumps(height: np.ndarray, angle: np.ndarray, bumps: tuple[tuple[float, ...], ...]) -> np.ndarray:
    total = np.zeros_like(height)
    for place, level, width, extent, size in bumps:
        turn = np.angle(np.exp(1j * (angle - place)))
        total += size * np.exp(-((turn / width) ** 2) - ((height - level) / extent) ** 2)
    return total


PROFILES: dict[str, Profile] = {"head": shape_head, "nutcracker": shape_nutcracker, "vase": shape_vase}
