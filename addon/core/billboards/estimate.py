"""Estimates within milliseconds, for any error: quads, triangles, texels and bytes of every level. `trial` is slower, and more accurate.

The cluster that would grow around a face f is guessed from the faces that one quad at f could hold. The whole surface then needs about
the sum over all faces of area(f) / area(cluster of f) quads, because the faces of a cluster of area a contribute a / a = 1 together. The
sum is estimated from a few seeds, sampled with a probability proportional to area.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import PointCloud, TriangleMesh, drop_degenerate, face_areas_and_normals, longest_side
from ..geometry.transforms import frames_from_normals
from .error_search import MAX_ERROR, MIN_ERROR
from .primitives import Primitives, drop_incomplete_points
from .settings import BillboardSettings

SEED_COUNT = 64  # Faces whose clusters are guessed.
NEAREST_COUNT = 300  # Nearest faces of each seed, used individually.
DISTANT_COUNT = 900  # Faces that represent all others, sampled proportionally to area.
BISECTION_STEPS = 10  # The final error range is less than one percent wide on a logarithmic scale.
BYTES_PER_TEXEL = 24  # Three maps of four bytes, front and back.
UNIFORM_RECTANGLE_FACTOR = 12.0  # Area of a uniformly filled rectangle over sqrt(det covariance).


@dataclass(frozen=True)
class Calibration:
    """Relation between guessed clusters and the quads of a method, measured on a sphere, a head and four trees.

    Attributes:
        max_waste: Of a guessed cluster, area of its rectangle over that of its faces.
        bounds_normals: Whether the method bounds the angle between faces and quads.
        quads_per_cluster: Quads per guessed cluster.
        triangles_per_quad: Triangles of the polygons that quads are cut to.
        area_factor: Area of the quads over the area of the guessed rectangles.
    """

    max_waste: float
    bounds_normals: bool
    quads_per_cluster: float
    triangles_per_quad: float
    area_factor: float


CALIBRATIONS = {
    "clusters": Calibration(max_waste=1.05, bounds_normals=True, quads_per_cluster=1.55, triangles_per_quad=2.1, area_factor=1.6),
    "hough": Calibration(max_waste=30.0, bounds_normals=False, quads_per_cluster=1.3, triangles_per_quad=2.3, area_factor=2.0),
    "decimate": Calibration(max_waste=1.05, bounds_normals=True, quads_per_cluster=3.4, triangles_per_quad=1.2, area_factor=2.0),
}


@dataclass(frozen=True)
class SurfaceSample:
    """A surface relative to S seed faces, with N faces each, ordered by distance from the seed; lengths and areas in scene units.

    Attributes:
        min_heights: (S, N) of a face's corners over the seed's plane.
        max_heights: (S, N) the same.
        positions: (S, N, 2) face centers in that plane, relative to the seed.
        cosines: (S, N) between the normals.
        areas: (S, N) of the faces, or of the surface that each represents.
        total_area: Area of the whole surface.
        longest_side: Longest bounding-box side of the whole surface.
        face_count: Number of its faces.
    """

    min_heights: np.ndarray
    max_heights: np.ndarray
    positions: np.ndarray
    cosines: np.ndarray
    areas: np.ndarray
    total_area: float
    longest_side: float
    face_count: int


@dataclass(frozen=True)
class LevelEstimate:
    """Estimate of one level.

    Attributes:
        error: A length in scene units.
        triangles: Number of triangles of the polygons that quads are cut to, and of decimated meshes.
        mesh_triangles: Number of those in decimated meshes of solid parts.
        quads: Number of quads, including one per chart of a decimated mesh.
        texels: Number of texels inside the quads.
        bytes: Size of all textures.
    """

    error: float
    triangles: int
    mesh_triangles: int
    quads: int
    texels: int
    bytes: int


def sample_geometry(geometry: TriangleMesh | PointCloud, name: str) -> SurfaceSample:
    """Sample `geometry` for any number of estimates.

    Raises:
        GeometryError: `geometry` is unusable; the message contains `name`.
    """
    if isinstance(geometry, PointCloud):
        cloud, _ = drop_incomplete_points(geometry, name)
        centers, normals, areas = cloud.points, cloud.normals, np.pi * cloud.radii**2
        return _sample(centers[:, None], normals, areas, longest_side(centers))
    mesh, _ = drop_degenerate(geometry, name)
    corners = mesh.corners
    areas, normals = face_areas_and_normals(corners)
    return _sample(corners, normals, areas, longest_side(corners.reshape(-1, 3)))


def sample_primitives(primitives: Primitives, side: float) -> SurfaceSample:
    """Sample `primitives`, which are part of a source with the longest side `side`."""
    return _sample(primitives.positions, primitives.normals, primitives.areas, side)


def _sample(corners: np.ndarray, normals: np.ndarray, areas: np.ndarray, side: float) -> SurfaceSample:
    """Sample faces with `corners` (T, C, 3) around the seeds: the nearest ones individually, the distant ones by random faces."""
    from scipy.spatial import cKDTree

    centers = corners.mean(axis=1)
    generator = np.random.default_rng(0)
    seeds, distant = _draw_by_area(areas, SEED_COUNT, generator), _draw_by_area(areas, DISTANT_COUNT, generator)
    near_count = min(NEAREST_COUNT, len(areas))
    distant = distant if near_count < len(areas) else distant[:0]
    distances, nearest = cKDTree(centers).query(centers[seeds], k=np.arange(1, near_count + 1))
    members = np.concatenate([nearest, np.broadcast_to(distant, (SEED_COUNT, len(distant)))], axis=1)
    offsets = centers[members] - centers[seeds][:, None]
    member_areas = np.concatenate([areas[nearest], np.full((SEED_COUNT, len(distant)), areas.sum() / DISTANT_COUNT)], axis=1)
    is_among_nearest = np.linalg.norm(offsets[:, near_count:], axis=2) <= distances[:, -1:]
    member_areas[:, near_count:][is_among_nearest] = 0.0
    frames = frames_from_normals(normals[seeds])
    local = np.einsum("sni,sci->snc", offsets, frames)
    order = np.argsort((local[..., :2] ** 2).sum(axis=2), axis=1)
    local = np.take_along_axis(local, order[..., None], axis=1)
    members = np.take_along_axis(members, order, axis=1)
    corner_heights = np.einsum("snci,si->snc", (corners - centers[:, None])[members], frames[:, 2])
    return SurfaceSample(
        min_heights=local[..., 2] + corner_heights.min(axis=2),
        max_heights=local[..., 2] + corner_heights.max(axis=2),
        positions=local[..., :2],
        cosines=np.einsum("sni,si->sn", normals[members], frames[:, 2]),
        areas=np.take_along_axis(member_areas, order, axis=1),
        total_area=float(areas.sum()),
        longest_side=side,
        face_count=len(areas),
    )


def _draw_by_area(areas: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Draw face indices (count,) with a probability proportional to area, stratified: one from each of `count` equal parts of the area."""
    cumulative = np.cumsum(areas)
    positions = (np.arange(count) + generator.random(count)) / count * cumulative[-1]
    return np.minimum(np.searchsorted(cumulative, positions, side="right"), len(areas) - 1)


def estimate_levels(sample: SurfaceSample, settings: BillboardSettings) -> list[LevelEstimate]:
    """Estimate all levels, finest first. Quads and texels are within about a factor of two of the result."""
    error = _resolve_error(sample, settings)
    return [estimate_level(sample, settings, error * 2.0**index) for index in range(settings.levels)]


def estimate_level(sample: SurfaceSample, settings: BillboardSettings, relative_error: float) -> LevelEstimate:
    """Estimate one level with `relative_error`, whatever the error and the budget of `settings`."""
    error = relative_error * sample.longest_side
    calibration = CALIBRATIONS[settings.method]
    clusters, waste = _estimate_clusters(sample, error, math.cos(settings.max_normal_deviation), calibration)
    quads = min(max(round(calibration.quads_per_cluster * clusters), 1), sample.face_count)
    texels = max(round(calibration.area_factor * waste * sample.total_area / (error * settings.texel_size) ** 2), quads)
    triangles = round(calibration.triangles_per_quad * quads)
    return LevelEstimate(error, triangles, 0, quads, texels, texels * BYTES_PER_TEXEL if settings.textures else 0)


def _estimate_clusters(sample: SurfaceSample, error: float, min_cosine: float, calibration: Calibration) -> tuple[float, float]:
    """Estimate the number of clusters that cover the surface, from the largest cluster of each seed, and their mean waste."""
    rows = np.arange(len(sample.min_heights))
    is_facing = (sample.cosines >= min_cosine) | (not calibration.bounds_normals)
    best_area, waste = np.zeros(len(rows)), np.ones(len(rows))
    for shift in (-1.0, 0.0, 1.0):  # The seed may be anywhere between the two sides of the slab that the error allows.
        fits = is_facing & (sample.min_heights >= (shift - 1.0) * error) & (sample.max_heights <= (shift + 1.0) * error)
        fits[:, 0] = True  # The seed itself, whatever its slope.
        fitting_areas = np.where(fits, sample.areas, 0.0)
        cluster_areas = np.maximum(np.cumsum(fitting_areas, axis=1), np.finfo(float).tiny)
        ratio = np.maximum(_rectangle_areas(fitting_areas, cluster_areas, sample.positions) / cluster_areas, 1.0)
        allowed = np.where(ratio <= calibration.max_waste, cluster_areas, 0.0)
        chosen = allowed.argmax(axis=1)
        larger = allowed[rows, chosen] > best_area
        best_area = np.where(larger, allowed[rows, chosen], best_area)
        waste = np.where(larger, ratio[rows, chosen], waste)
    return float(np.mean(sample.total_area / best_area)), float(waste.mean())


def _rectangle_areas(areas: np.ndarray, cluster_areas: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Estimate the areas (S, N) of the rectangles around the first n faces of each seed, n = 1..N, from their covariance.

    Args:
        areas: (S, N) of the faces, 0 for those outside the cluster. cluster_areas: (S, N) their cumulative sum.
        positions: (S, N, 2).
    """
    x, y = positions[..., 0], positions[..., 1]
    area_x, area_y = areas * x, areas * y
    mean_x, mean_y = np.cumsum(area_x, axis=1) / cluster_areas, np.cumsum(area_y, axis=1) / cluster_areas
    xx = np.cumsum(area_x * x, axis=1) / cluster_areas - mean_x**2
    yy = np.cumsum(area_y * y, axis=1) / cluster_areas - mean_y**2
    xy = np.cumsum(area_x * y, axis=1) / cluster_areas - mean_x * mean_y
    return UNIFORM_RECTANGLE_FACTOR * np.sqrt(np.maximum(xx * yy - xy**2, 0.0))


def _resolve_error(sample: SurfaceSample, settings: BillboardSettings) -> float:
    """Return the relative error of the settings, or the smallest one within their budget of quads or megabytes."""
    if not settings.quads and not settings.triangles and not settings.texture_mb:
        return settings.error
    low, high = MIN_ERROR, MAX_ERROR
    count = settings.levels if settings.texture_mb else 1  # Quads and triangles are those of the finest level.
    for _ in range(BISECTION_STEPS):
        candidate = math.sqrt(low * high)
        levels = [estimate_level(sample, settings, candidate * 2.0**index) for index in range(count)]
        counted = (levels[0].quads, settings.quads), (levels[0].triangles, settings.triangles)
        has_too_many = any(limit and number > limit for number, limit in counted)
        is_too_large = settings.texture_mb and sum(level.texels for level in levels) * BYTES_PER_TEXEL > settings.texture_mb * 1e6
        low, high = (candidate, high) if has_too_many or is_too_large else (low, candidate)
    return high
