"""What a cloud will take, told before it is built: quads, texels and bytes of every level.

The cluster that would grow around a face f is guessed from the faces that one quad at f could hold. The whole surface then needs about
the sum over all faces of area(f) / area(cluster of f) quads, since the faces of a cluster of area a contribute a / a = 1 together. The
sum is taken over a few seeds drawn in proportion to area.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..mesh import PointCloud, TriangleMesh, check_points, face_areas_and_normals, longest_side, without_zero_area
from ..settings import describe
from .primitives import Primitives
from .settings import BillboardSettings

SEEDS = 64  # faces whose clusters are guessed
NEAR = 300  # nearest faces of each seed, taken one by one
FAR = 900  # faces that stand for all the others, drawn in proportion to area
SEARCH_ROUNDS = 10  # halvings of the range of errors, on a logarithmic scale: ends within one per cent
BYTES_PER_TEXEL = 24  # three maps of four bytes, front and back


@dataclass(frozen=True)
class Calibration:
    """What guessed clusters have to do with the quads that a method builds, measured on a sphere, a head and four trees.

    most_waste: of a guessed cluster, area of its rectangle over that of its faces. bounds_normals: whether the method keeps faces off quads
    that they lean away from. quads: for each guessed cluster. area: of the quads, for each area of guessed rectangles.
    """

    most_waste: float
    bounds_normals: bool
    quads: float
    area: float


CALIBRATION = {
    "clusters": Calibration(most_waste=1.05, bounds_normals=True, quads=1.55, area=1.6),
    "hough": Calibration(most_waste=30.0, bounds_normals=False, quads=1.3, area=2.0),
    "decimate": Calibration(most_waste=1.05, bounds_normals=True, quads=3.4, area=2.0),
}


@dataclass(frozen=True)
class Sample:
    """A surface as seen from S seeds, N faces each, ordered by distance from the seed; lengths and areas in scene units.

    lows, highs (S, N): lowest and highest corner over the seed's plane. places (S, N, 2): centers in that plane, from the seed.
    cosines (S, N): between the normals.
    areas (S, N): of the faces, or what each stands for. area, longest_side: of the whole surface. faces: how many there are in all.
    """

    lows: np.ndarray
    highs: np.ndarray
    places: np.ndarray
    cosines: np.ndarray
    areas: np.ndarray
    area: float
    longest_side: float
    faces: int


@dataclass(frozen=True)
class LevelEstimate:
    """One level: error is a length in scene units, bytes those of all its textures."""

    error: float
    quads: int
    texels: int
    bytes: int


def take_sample(geometry: TriangleMesh | PointCloud, name: str) -> Sample:
    """A sample of `geometry` that serves any number of estimates.

    Raises:
        GeometryError: when nothing can be built from it; `name` says whose it is.
    """
    if isinstance(geometry, PointCloud):
        check_points(geometry.points, name)
        centers, normals, areas = geometry.points, geometry.normals, np.pi * geometry.radii**2
        return _sample(centers[:, None], normals, areas, longest_side(centers))
    mesh, _ = without_zero_area(geometry, name)
    corners = mesh.corners
    areas, normals = face_areas_and_normals(corners)
    return _sample(corners, normals, areas, longest_side(corners.reshape(-1, 3)))


def sample_of(primitives: Primitives, side: float) -> Sample:
    """A sample of `primitives` that are a part of something with the longest side `side`."""
    return _sample(primitives.positions, primitives.normals, primitives.areas, side)


def _sample(corners: np.ndarray, normals: np.ndarray, areas: np.ndarray, side: float) -> Sample:
    """The view from the seeds: their nearest faces as they are, and a draw of all faces for what lies beyond these."""
    from scipy.spatial import cKDTree

    centers = corners.mean(axis=1)
    generator = np.random.default_rng(0)
    seeds, drawn = _draw(areas, SEEDS, generator), _draw(areas, FAR, generator)
    near = min(NEAR, len(areas))
    reach, nearest = cKDTree(centers).query(centers[seeds], k=np.arange(1, near + 1))
    members = np.concatenate([nearest, np.broadcast_to(drawn, (SEEDS, FAR))], axis=1)
    offsets = centers[members] - centers[seeds][:, None]
    own = np.concatenate([areas[nearest], np.full((SEEDS, FAR), areas.sum() / FAR)], axis=1)
    own[:, near:][np.linalg.norm(offsets[:, near:], axis=2) <= reach[:, -1:]] = 0.0  # stands among the nearest already
    frames = np.stack([_frame(normal) for normal in normals[seeds]])
    local = np.einsum("sni,sci->snc", offsets, frames)
    order = np.argsort((local[..., :2] ** 2).sum(axis=2), axis=1)
    local = np.take_along_axis(local, order[..., None], axis=1)
    members = np.take_along_axis(members, order, axis=1)
    tips = np.einsum("snci,si->snc", (corners - centers[:, None])[members], frames[:, 2])
    return Sample(
        lows=local[..., 2] + tips.min(axis=2),
        highs=local[..., 2] + tips.max(axis=2),
        places=local[..., :2],
        cosines=np.einsum("sni,si->sn", normals[members], frames[:, 2]),
        areas=np.take_along_axis(own, order, axis=1),
        area=float(areas.sum()),
        longest_side=side,
        faces=len(areas),
    )


def _frame(normal: np.ndarray) -> np.ndarray:
    """Two unit vectors across `normal` (3,) and itself, as rows (3, 3)."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(normal, across), normal])


def _draw(areas: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Indices (count,) of faces with a chance in proportion to area: one in each of `count` equal shares, so that none lump together."""
    bounds = np.cumsum(areas)
    places = (np.arange(count) + generator.random(count)) / count * bounds[-1]
    return np.minimum(np.searchsorted(bounds, places, side="right"), len(areas) - 1)


def estimate(sample: Sample, settings: BillboardSettings) -> list[LevelEstimate]:
    """What each level will take, from fine to coarse; within about a factor of two."""
    error = _error_that_meets(sample, settings)
    return [_level(sample, settings, error * 2.0**index) for index in range(settings.levels)]


def _level(sample: Sample, settings: BillboardSettings, share: float) -> LevelEstimate:
    """One level with the error `share` of the longest side."""
    error = share * sample.longest_side
    calibration = CALIBRATION[settings.method]
    clusters, waste = _clusters(sample, error, math.cos(settings.max_normal_deviation), calibration)
    quads = min(max(round(calibration.quads * clusters), 1), sample.faces)
    texels = max(round(calibration.area * waste * sample.area / (error * settings.texel_error) ** 2), quads)
    return LevelEstimate(error, quads, texels, texels * BYTES_PER_TEXEL if settings.textures else 0)


def _clusters(sample: Sample, error: float, least_cosine: float, calibration: Calibration) -> tuple[float, float]:
    """How many of the largest clusters around the seeds it takes to hold the whole surface, and their mean waste."""
    rows = np.arange(len(sample.lows))
    facing = (sample.cosines >= least_cosine) | (not calibration.bounds_normals)
    most, waste = np.zeros(len(rows)), np.ones(len(rows))
    for shift in (-1.0, 0.0, 1.0):  # the seed may lie anywhere between the two sides of the slab that the error allows
        fits = facing & (sample.lows >= (shift - 1.0) * error) & (sample.highs <= (shift + 1.0) * error)
        fits[:, 0] = True  # the seed itself, however steep
        inside = np.where(fits, sample.areas, 0.0)
        held = np.maximum(np.cumsum(inside, axis=1), np.finfo(float).tiny)
        spread = np.maximum(_rectangle_areas(inside, held, sample.places) / held, 1.0)
        allowed = np.where(spread <= calibration.most_waste, held, 0.0)
        chosen = allowed.argmax(axis=1)
        larger = allowed[rows, chosen] > most
        most = np.where(larger, allowed[rows, chosen], most)
        waste = np.where(larger, spread[rows, chosen], waste)
    return float(np.mean(sample.area / most)), float(waste.mean())


def _rectangle_areas(inside: np.ndarray, held: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(S, N) areas of the rectangles around the first faces that are `inside` (S, N, areas), told from how far they scatter.

    A rectangle that is evenly filled has 12 sqrt(det covariance) as its area.
    """
    x, y = places[..., 0], places[..., 1]
    mean_x, mean_y = np.cumsum(inside * x, axis=1) / held, np.cumsum(inside * y, axis=1) / held
    xx = np.cumsum(inside * x * x, axis=1) / held - mean_x**2
    yy = np.cumsum(inside * y * y, axis=1) / held - mean_y**2
    xy = np.cumsum(inside * x * y, axis=1) / held - mean_x * mean_y
    return 12.0 * np.sqrt(np.maximum(xx * yy - xy**2, 0.0))


def _error_that_meets(sample: Sample, settings: BillboardSettings) -> float:
    """The share of the longest side that is asked for, or the smallest that keeps to the quads and megabytes that are asked for."""
    if not settings.quads and not settings.texture_mb:
        return settings.error
    limits = next(item for item in describe(BillboardSettings) if item.name == "error")
    low, high = limits.minimum, limits.maximum
    for _ in range(SEARCH_ROUNDS):
        middle = math.sqrt(low * high)
        levels = [_level(sample, settings, middle * 2.0**index) for index in range(settings.levels)]
        too_many = settings.quads and levels[0].quads > settings.quads
        too_large = settings.texture_mb and sum(level.texels for level in levels) * BYTES_PER_TEXEL > settings.texture_mb * 1e6
        low, high = (middle, high) if too_many or too_large else (low, middle)
    return high
