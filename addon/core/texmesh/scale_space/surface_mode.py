"""Scale space on the surface: curvature and lightness diffused, for meshes of any topology."""

from collections.abc import Sequence

import numpy as np

from ...geometry.edges import find_edges
from ...jobs.progress import Progress, Steps, subprogress
from ..textured_mesh import TexturedMesh
from .coarsening import build_levels
from .cotangent_laplacian import assemble_laplacian, integrate_over_vertices, mollify_lengths, triangle_areas
from .curvature import integrate_mean_curvature
from .diffusion import choose_times, diffuse, search_last_sigma
from .feature_spacing import rank_coverage, thin_features
from .feature_tracing import FeatureTracer
from .lightness import sample_lightness
from .scale_map import ScaleMap
from .settings import ScaleSpaceSettings

MIN_MASS = 1e-12  # of the mean, of a vertex: one without triangles has this
FIRST_RADIUS = 1.6  # of aggregates, relative to the distance between vertices
MAX_SIGMA = 0.25  # relative to the square root of the area
MAX_RADIUS = 0.1  # relative to the same
MIN_RANGES = np.array([0.05, 0.1])  # a turn in radians and a lightness; smaller signals are weak features, not stretched to strong ones


def analyze_surface(mesh: TexturedMesh, textures: Sequence[np.ndarray | None], settings: ScaleSpaceSettings) -> Steps[ScaleMap]:
    """Return the scale map of `mesh` by diffusion on its surface; arguments as for `analyze_scale_space`.

    Features are zero crossings of the Laplacian of the diffused mean curvature, and of the diffused lightness of the textures. Of the ends
    of an edge across which a Laplacian changes its sign, the one nearer to the crossing is the feature. It is traced to the mesh, and ends
    at a lower scale where a more persistent or stronger one is too close.
    """
    yield Progress(0.0, "Measuring curvature")
    points, unit = _normalize(mesh)
    edges = find_edges(mesh.triangles, len(points))
    lengths = mollify_lengths(points, mesh.triangles)
    areas = triangle_areas(lengths)
    masses = integrate_over_vertices(mesh.triangles, areas, np.ones(mesh.triangles.shape), len(points))
    spacing = float(np.sqrt(np.median(masses)))
    masses = np.maximum(masses, MIN_MASS * masses.mean())
    signals, weights = [integrate_mean_curvature(points, mesh.triangles, edges)], [min(1.0, 2.0 - 2.0 * settings.texture_weight)]
    yield Progress(0.03, "Reading textures")
    lightness, losses = _integrate_lightness(mesh, textures if settings.texture_weight > 0.0 else (), areas)
    if lightness is not None:
        signals.append(lightness)
        weights.append(min(1.0, 2.0 * settings.texture_weight))
    integrals, weights = np.stack(signals, axis=1), np.array(weights if len(signals) > 1 else [1.0])

    yield Progress(0.08, "Building coarse levels")
    laplacian = assemble_laplacian(mesh.triangles, lengths, len(points))
    levels = build_levels(laplacian, masses, points, FIRST_RADIUS * spacing, MAX_RADIUS)
    last_sigma, largest = search_last_sigma(levels, integrals, weights, settings.convergence, MAX_SIGMA)
    times, growth = choose_times(spacing, last_sigma)
    laplacians, ranges = yield from subprogress(diffuse(levels, integrals, times, growth), 0.2, 0.9)
    sigmas = np.sqrt(2.0 * times)
    scales = weights / np.maximum(largest, MIN_RANGES[: len(weights)])

    yield Progress(0.9, "Finding features")
    raw = np.stack([integrals[:, 0] / np.sqrt(masses), *(integrals[:, 1:] / masses[:, None]).T], axis=1)
    tracer = FeatureTracer(points, edges, raw * scales, settings.noise)
    for index, sigma in enumerate(sigmas):
        units = np.array([sigma, 1.0])[: len(weights)]  # curvature becomes the angle turned over a sigma
        tracer.add(index + 1, laplacians[index] * (scales * units * sigma**3))
    sigmas = np.concatenate([[0.0], sigmas])
    features = tracer.features
    features.last_scales = thin_features(points, features.last_scales, features.strengths, sigmas, settings.spacing)
    coverage = rank_coverage(points, features.last_scales, tracer.contrasts, sigmas, settings.spacing)
    features.strengths = np.where(features.last_scales > 0, features.strengths, coverage).astype(np.float32)
    raw_ranges = np.concatenate([[np.ptp(raw, axis=0)], ranges * np.stack([sigmas[1:], np.ones(len(times))], axis=1)[:, : len(weights)]])
    relative = (raw_ranges / np.where(largest > 0.0, largest, 1.0)) @ weights / weights.sum()
    return features.to_scale_map(sigmas * unit, relative, losses)


def _normalize(mesh: TexturedMesh) -> tuple[np.ndarray, float]:
    """Return the vertices (V, 3) around the origin with a surface of area 1, and the length of that unit in the unit of the mesh."""
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    points = (mesh.vertices - mesh.vertices.mean(axis=0)) / extent
    area = float(triangle_areas(mollify_lengths(points, mesh.triangles)).sum())
    return points / np.sqrt(area), extent * float(np.sqrt(area))


def _integrate_lightness(mesh: TexturedMesh, textures: Sequence[np.ndarray | None], areas: np.ndarray) -> tuple[np.ndarray | None, str]:
    """Return the lightness of the textures integrated around each vertex, (V,), None without textures, and a sentence about triangles
    without one, "" for none. They have the mean lightness of the others."""
    lightness, has_texture = sample_lightness(mesh, textures)
    if not has_texture.any():
        return None, ""
    mean = float((lightness[has_texture].mean(axis=1) @ areas[has_texture]) / areas[has_texture].sum())
    lightness[~has_texture] = mean
    missing = float(areas[~has_texture].sum() / areas.sum())
    losses = f"{100.0 * missing:.1f}% of the area has no texture; only its shape counts." if missing > 0.0 else ""
    return integrate_over_vertices(mesh.triangles, areas, lightness - mean, len(mesh.vertices)), losses
