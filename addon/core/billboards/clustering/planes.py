"""Planes of sets of primitives: the minimax fit, and the test whether a plane may show a primitive."""

from dataclasses import dataclass

import numpy as np

from ...arrays import TINY
from ...geometry.directions import fibonacci_sphere
from ...geometry.transforms import frames_from_normals
from ..primitives import Primitives

SUPPORT_COUNT = 64  # Extreme points of a set that the fit uses.
LAWSON_STEPS = 30  # Reweighting gains little after that.
LAWSON_FLOOR = 1e-3  # This fraction of the thickness is added to the distances, so that the weights of points on the plane stay above zero.
FLAT_TOLERANCE = 1e-6  # A set thinner than this fraction of its extent needs no better plane than the least-squares one.
CANCELLED_NORMAL = 1e-9  # Length of the area-weighted mean normal, below which it has no direction.
STEEP_SCALE = 0.25  # Scales horizontal components of half of the support directions: within about 25 degrees of the set's normal.


@dataclass(frozen=True)
class Planes:
    """Q planes normal . x = offset: normals (Q, 3) unit, offsets (Q,), float64."""

    normals: np.ndarray
    offsets: np.ndarray

    def __len__(self) -> int:
        return len(self.normals)

    def subset(self, indices: np.ndarray) -> "Planes":
        """Return the planes `indices` (K,), in that order."""
        return Planes(self.normals[indices], self.offsets[indices])


@dataclass(frozen=True)
class PlaneBounds:
    """Bounds that every primitive on a plane must satisfy.

    error: maximum distance of its corners to the plane, a length. min_cosine: minimum cosine between its normal and that of the plane, or
    None if normals do not matter.
    """

    error: float
    min_cosine: float | None = None

    def contain(
        self, positions: np.ndarray, normals: np.ndarray, plane_normals: np.ndarray, plane_offsets: np.ndarray | float
    ) -> np.ndarray:
        """Test which primitives satisfy the bounds: (K,) bool.

        Args:
            positions: (K, C, 3) corners. normals: (K, 3) unit.
            plane_normals, plane_offsets: (K, 3) and (K,), one plane per primitive, or (3,) and a number, one plane for all.
        """
        if plane_normals.ndim == 1:
            is_inside = (np.abs(positions @ plane_normals - plane_offsets) <= self.error).all(axis=1)
            return is_inside if self.min_cosine is None else is_inside & (normals @ plane_normals >= self.min_cosine)
        is_inside = np.ones(len(positions), bool)
        if self.min_cosine is not None:
            is_inside &= np.einsum("ki,ki->k", normals, plane_normals) >= self.min_cosine
        for corner in range(positions.shape[1]):
            is_inside &= np.abs(np.einsum("ki,ki->k", positions[:, corner], plane_normals) - plane_offsets) <= self.error
        return is_inside


def mean_normals(primitives: Primitives, sets: list[np.ndarray]) -> np.ndarray:
    """Compute area-weighted unit mean normals (Q, 3) of the primitives in each set, or the first one's normal if they cancel out."""
    weighted = primitives.normals * primitives.areas[:, None]
    offsets = np.cumsum([0] + [len(members) for members in sets])
    sums = np.add.reduceat(weighted[np.concatenate(sets)], offsets[:-1], axis=0)
    lengths = np.linalg.norm(sums, axis=1)
    areas = np.add.reduceat(primitives.areas[np.concatenate(sets)], offsets[:-1])
    is_cancelled = lengths < CANCELLED_NORMAL * areas
    sums[is_cancelled] = primitives.normals[[sets[index][0] for index in np.flatnonzero(is_cancelled)]]
    return sums / np.where(is_cancelled, 1.0, lengths)[:, None]


def fit_planes(primitives: Primitives, sets: list[np.ndarray]) -> Planes:
    """Fit minimax planes to Q non-empty sets of primitives.

    Lawson's algorithm: a weighted least-squares plane whose weights grow with the distance converges to the plane with the smallest
    maximum distance. It uses extreme points of each set, found along directions close to the set's mean normal.

    Returns:
        The planes, midway between the outermost points, with normals on the side of the faces' normals.
    """
    means = mean_normals(primitives, sets)
    points = _find_support_points(primitives, sets, means)
    normals = _least_spread_directions(points, np.full(points.shape[:2], 1.0 / SUPPORT_COUNT))
    offsets, thickness = _center_planes(points, normals)
    thick = np.flatnonzero(thickness > FLAT_TOLERANCE * np.ptp(points, axis=1).max(axis=1))
    if len(thick):
        better = _fit_lawson(points[thick])
        normals[thick], offsets[thick] = better.normals, better.offsets
    sign = np.where(np.einsum("qi,qi->q", normals, means) < 0.0, -1.0, 1.0)
    return Planes(normals * sign[:, None], offsets * sign)


def _fit_lawson(points: np.ndarray) -> Planes:
    """Fit the planes with the smallest maximum distance to `points` (Q, SUPPORT_COUNT, 3)."""
    weights = np.full(points.shape[:2], 1.0 / SUPPORT_COUNT)
    best_thickness = np.full(len(points), np.inf)
    normals, offsets = np.zeros((len(points), 3)), np.zeros(len(points))
    for _ in range(LAWSON_STEPS):
        normal = _least_spread_directions(points, weights)
        offset, thickness = _center_planes(points, normal)
        better = thickness < best_thickness
        best_thickness[better], normals[better], offsets[better] = thickness[better], normal[better], offset[better]
        distances = np.abs(np.einsum("qsi,qi->qs", points, normal) - offset[:, None])
        weights *= distances + LAWSON_FLOOR * thickness[:, None] + TINY
        weights /= weights.sum(axis=1, keepdims=True)
    return Planes(normals, offsets)


def _least_spread_directions(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Compute the unit directions (Q, 3) of least variance of weighted `points` (Q, S, 3)."""
    centered = points - np.einsum("qs,qsi->qi", weights, points)[:, None]
    return np.linalg.eigh(np.swapaxes(centered * weights[:, :, None], 1, 2) @ centered)[1][:, :, 0]


def _center_planes(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the offsets (Q,) of planes midway between the outermost of `points` (Q, S, 3) along `normals`, and their thickness (Q,)."""
    heights = np.einsum("qsi,qi->qs", points, normals)
    low, high = heights.min(axis=1), heights.max(axis=1)
    return 0.5 * (low + high), high - low


def _find_support_points(primitives: Primitives, sets: list[np.ndarray], means: np.ndarray) -> np.ndarray:
    """Find (Q, SUPPORT_COUNT, 3) extreme points of each set; half of the directions are close to the axis of its mean normal."""
    sphere = fibonacci_sphere(SUPPORT_COUNT)
    steep = sphere[::2] * np.array([STEEP_SCALE, STEEP_SCALE, 1.0])
    local = np.concatenate([sphere[1::2], steep / np.linalg.norm(steep, axis=1, keepdims=True)])
    directions = np.einsum("si,qij->qsj", local, frames_from_normals(means))
    support = np.empty((len(sets), SUPPORT_COUNT, 3))
    for index, members in enumerate(sets):
        points = primitives.points[primitives.find_points(members)]
        support[index] = points[(points @ directions[index].T).argmax(axis=0)]
    return support
