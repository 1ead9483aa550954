"""The analysis of a textured mesh in scale space (sections II and III.A of the TexMesh paper).

On the surface, mean curvature and the lightness of the texture, at the resolution of the triangles, are diffused, for meshes of any
topology. Curvature that is integrated over the surface does not depend on the triangulation. The cotangent Laplacian is robust against thin
triangles by intrinsic mollification after Sharp and Crane, "A Laplacian for Nonmanifold Triangle Meshes" (2020), section 4.5: all edges are
lengthened by the same small amount, so that no triangle is degenerate. Positions do not change.
"""

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from ...geometry.edges import Edges, find_edges, halfedge_ends
from ...geometry.mesh import face_areas_and_normals
from ...geometry.transforms import signed_areas
from ...imaging.colors import LUMINANCE
from ...imaging.mipmaps import build_mipmaps, sample_mipmaps
from ...jobs.progress import Progress, Steps, subprogress
from ..settings import AnalysisSettings
from ..textured_mesh import TexturedMesh
from .diffusion import build_levels, choose_times, diffuse, search_last_sigma
from .features import FeatureTracer, ScaleMap, rank_coverage, thin_features
from .range_image import analyze_range_image

MIN_MASS = 1e-12  # Relative to the mean; a vertex without triangles has this mass.
FIRST_RADIUS = 1.6  # Radius of aggregates, relative to the distance between vertices.
MAX_SIGMA = 0.25  # relative to the square root of the area
MAX_RADIUS = 0.1  # relative to the same
MIN_RANGES = np.array([0.05, 0.1])  # a turn in radians and a lightness; smaller signals are weak features, not stretched to strong ones
POINTS = np.full((3, 3), 1.0 / 6.0) + 0.5 * np.eye(3)  # barycentric coordinates of samples, one near each corner
CUBE_ROOT_LIMIT, LINE_SCALE = (6.0 / 29.0) ** 3, 9.0329  # Constants of CIE L*, as a fraction of white.
MOLLIFICATION = 1e-5  # Two sides of a triangle together are longer than the third by this fraction of the mean edge length.


def analyze_scale_space(mesh: TexturedMesh, textures: Sequence[np.ndarray | None], settings: AnalysisSettings) -> Steps[ScaleMap]:
    """Find for each vertex of `mesh` the last of 21 scales at which it is a feature.

    textures: per material an image (H, W, 3) float32, scene-linear, row 0 at the bottom, or None. Range images
    show the shape alone.

    Raises:
        GeometryError: with a range image, next to nothing of the surface faces the axis.
    """
    if settings.analysis == "range_image":
        return (yield from analyze_range_image(mesh, settings))
    return (yield from analyze_surface(mesh, textures, settings))


def analyze_surface(mesh: TexturedMesh, textures: Sequence[np.ndarray | None], settings: AnalysisSettings) -> Steps[ScaleMap]:
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


def sample_lightness(mesh: TexturedMesh, textures: Sequence[np.ndarray | None]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lightness (T, 3) float32, 0 to 1, near each corner of the triangles of `mesh`, and which triangles (T,) bool have a
    texture.

    A sample is the mean over texels of about a third of its triangle, from a level of mipmaps, so that detail finer than the mesh
    does not alias. Textures repeat outside 0..1. Triangles without a texture are 0.

    textures: per material an image (H, W, 3) float32, scene-linear, or None; further channels are ignored.
    """
    lightness = np.zeros(mesh.triangles.shape, np.float32)
    has_texture = np.zeros(len(mesh.triangles), bool)
    for material, texture in enumerate(textures):
        rows = np.flatnonzero(mesh.materials == material)
        if texture is None or texture.size == 0 or not len(rows):
            continue
        has_texture[rows] = True
        corner_uvs = mesh.corner_uvs[rows]
        texels = np.abs(signed_areas(corner_uvs)) * (texture.shape[0] * texture.shape[1] / len(POINTS))
        positions = np.einsum("pc,tcx->tpx", POINTS, corner_uvs).reshape(-1, 2)
        mipmaps = build_mipmaps(_luminance_of(texture)[..., None])
        luminance = sample_mipmaps(mipmaps, positions, np.repeat(np.sqrt(texels), len(POINTS)))
        lightness[rows] = encode_lightness(luminance).reshape(-1, 3)
    return lightness, has_texture


def encode_lightness(luminance: np.ndarray) -> np.ndarray:
    """Return the CIE lightness L* as a fraction, 0 to 1, of relative `luminance`, scene-linear, of any shape."""
    clipped = np.clip(luminance, 0.0, 1.0)
    return np.where(clipped <= CUBE_ROOT_LIMIT, LINE_SCALE * clipped, 1.16 * np.cbrt(clipped) - 0.16)


def _luminance_of(texture: np.ndarray) -> np.ndarray:
    """Return the luminance (H, W) float32 of a scene-linear `texture` (H, W, C), within 0 to 1, so that no highlight outshines a level."""
    values = texture[..., :3] @ LUMINANCE if texture.shape[2] >= 3 else texture[..., 0]
    limited = np.fmin(values, np.float32(1.0))  # fmin and fmax replace what is not a number
    return np.fmax(limited, np.float32(0.0), out=limited)


def mollify_lengths(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the lengths (T, 3) of the edges opposite to the corners of `triangles` (T, 3), mollified. vertices: (V, 3)."""
    corners = vertices[triangles]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1), axis=2)
    excess = lengths.sum(axis=1, keepdims=True) - 2.0 * lengths
    return lengths + max(0.0, MOLLIFICATION * float(lengths.mean()) - float(excess.min()))


def triangle_areas(lengths: np.ndarray) -> np.ndarray:
    """Return the areas (T,) of triangles with edge `lengths` (T, 3), by Kahan's stable form of Heron's formula."""
    c, b, a = np.sort(lengths, axis=1).T
    return 0.25 * np.sqrt(np.maximum((a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c)), 0.0))


def assemble_laplacian(triangles: np.ndarray, lengths: np.ndarray, vertex_count: int) -> sparse.csc_array:
    """Return the positive semidefinite cotangent Laplacian (V, V), the integral of the product of gradients of hat functions.

    triangles: (T, 3). lengths: (T, 3), of the edges opposite to each corner, none degenerate (`mollify_lengths`).
    """
    squared = lengths**2
    half_cotangents = (squared.sum(axis=1, keepdims=True) - 2.0 * squared) / (8.0 * triangle_areas(lengths))[:, None]
    starts, ends = np.roll(triangles, -1, axis=1).ravel(), np.roll(triangles, -2, axis=1).ravel()
    weights = half_cotangents.ravel()
    rows, columns = np.concatenate([starts, ends, starts, ends]), np.concatenate([ends, starts, starts, ends])
    values = np.concatenate([-weights, -weights, weights, weights])
    return sparse.coo_array((values, (rows, columns)), shape=(vertex_count, vertex_count)).tocsc()


def integrate_over_vertices(triangles: np.ndarray, areas: np.ndarray, corner_values: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return the integrals (V,) of `corner_values` (T, 3), each over a third of its triangle's area. areas: (T,)."""
    return np.bincount(triangles.ravel(), (areas[:, None] / 3.0 * corner_values).ravel(), minlength=vertex_count)


def integrate_mean_curvature(vertices: np.ndarray, triangles: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the mean curvature integrated around each vertex, (V,) float64, positive where the surface is convex (Steiner's formula).

    An edge has half its dihedral angle times its length, divided among its ends. Boundaries and edges with more than two triangles, or with
    two of opposite orientation, have none. The value of a vertex stays bounded however small its triangles are, so that filtering averages
    the noise of fine meshes, and a crease has the same strength at all densities.
    """
    corners = vertices[triangles]
    normals = face_areas_and_normals(corners)[1]
    first, second = edges.interior_halfedges.T
    starts, ends = halfedge_ends(triangles, first).T
    is_oriented = starts == halfedge_ends(triangles, second)[:, 1]
    first, second, starts, ends = first[is_oriented], second[is_oriented], starts[is_oriented], ends[is_oriented]
    left, right, along = normals[first // 3], normals[second // 3], vertices[ends] - vertices[starts]
    lengths = np.linalg.norm(along, axis=1)
    sines = np.einsum("ij,ij->i", np.cross(left, right), along / np.where(lengths > 0.0, lengths, 1.0)[:, None])
    angles = np.arctan2(sines, np.einsum("ij,ij->i", left, right))
    halves = 0.25 * angles * lengths
    return np.bincount(starts, halves, minlength=len(vertices)) + np.bincount(ends, halves, minlength=len(vertices))
