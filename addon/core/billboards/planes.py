"""Planes through sets of primitives: the one whose largest distance to their corners is least."""

import numpy as np

from ..directions import fibonacci_sphere
from .primitives import Primitives

SUPPORT = 64  # extreme points of a set that the fit looks at
ROUNDS = 30  # of Lawson's reweighting; it gains little after that
FLAT = 1e-6  # of its extent: a thinner set needs no better plane


def frames_of(normals: np.ndarray) -> np.ndarray:
    """Right-handed frames (Q, 3, 3), rows u, v, n, for unit `normals` (Q, 3)."""
    helper = np.eye(3)[np.abs(normals).argmin(axis=1)]
    u = np.cross(helper, normals)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.stack([u, np.cross(normals, u), normals], axis=1)


def mean_normals(primitives: Primitives, sets: list[np.ndarray]) -> np.ndarray:
    """Area-weighted unit mean normals (Q, 3) of the primitives in each set; where they cancel, the first one's normal."""
    weighted = primitives.normals * primitives.areas[:, None]
    offsets = np.cumsum([0] + [len(members) for members in sets])
    sums = np.add.reduceat(weighted[np.concatenate(sets)], offsets[:-1], axis=0)
    lengths = np.linalg.norm(sums, axis=1)
    total = np.add.reduceat(primitives.areas[np.concatenate(sets)], offsets[:-1])
    lost = lengths < 1e-9 * total
    sums[lost] = primitives.normals[[sets[index][0] for index in np.flatnonzero(lost)]]
    return sums / np.where(lost, 1.0, lengths)[:, None]


def fit_planes(primitives: Primitives, sets: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Minimax planes of Q non-empty sets of primitives.

    Lawson's algorithm: a weighted least-squares plane whose weights grow where the distance is large tends to the plane with the
    least largest distance. It looks at extreme points of each set, chosen along directions close to the set's own normal.

    Returns:
        normals (Q, 3) unit, turned to the side that the faces look to; offsets (Q,): the plane is normal . x = offset, midway.
    """
    means = mean_normals(primitives, sets)
    points = _support_points(primitives, sets, means)
    normals, offsets, thickness = _midway(points, _least_axes(points, np.full(points.shape[:2], 1.0 / SUPPORT)))
    thick = np.flatnonzero(thickness > FLAT * np.ptp(points, axis=1).max(axis=1))
    if len(thick):
        better_normals, better_offsets = _lawson(points[thick])
        normals[thick], offsets[thick] = better_normals, better_offsets
    sign = np.where(np.einsum("qi,qi->q", normals, means) < 0.0, -1.0, 1.0)
    return normals * sign[:, None], offsets * sign


def _lawson(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals (Q, 3) and offsets (Q,) of the planes with the least largest distance to `points` (Q, SUPPORT, 3)."""
    weights = np.full(points.shape[:2], 1.0 / SUPPORT)
    best = np.full(len(points), np.inf)
    normals, offsets = np.zeros((len(points), 3)), np.zeros(len(points))
    for _ in range(ROUNDS):
        normal = _least_axes(points, weights)
        normal, offset, thickness = _midway(points, normal)
        better = thickness < best
        best[better], normals[better], offsets[better] = thickness[better], normal[better], offset[better]
        distances = np.abs(np.einsum("qsi,qi->qs", points, normal) - offset[:, None])
        weights *= distances + 1e-3 * thickness[:, None] + 1e-300
        weights /= weights.sum(axis=1, keepdims=True)
    return normals, offsets


def _least_axes(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Unit directions (Q, 3) in which weighted `points` (Q, S, 3) spread least."""
    centred = points - np.einsum("qs,qsi->qi", weights, points)[:, None]
    return np.linalg.eigh(np.swapaxes(centred * weights[:, :, None], 1, 2) @ centred)[1][:, :, 0]


def _midway(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The planes midway between the outermost of `points` (Q, S, 3) along `normals`: normals, offsets (Q,), thickness (Q,)."""
    heights = np.einsum("qsi,qi->qs", points, normals)
    low, high = heights.min(axis=1), heights.max(axis=1)
    return normals, 0.5 * (low + high), high - low


def _support_points(primitives: Primitives, sets: list[np.ndarray], means: np.ndarray) -> np.ndarray:
    """(Q, SUPPORT, 3) extreme points of each set; half of the directions lie within about 25 degrees of its normal's axis."""
    sphere = fibonacci_sphere(SUPPORT)
    steep = sphere[::2] * np.array([0.25, 0.25, 1.0])
    local = np.concatenate([sphere[1::2], steep / np.linalg.norm(steep, axis=1, keepdims=True)])
    directions = np.einsum("si,qij->qsj", local, frames_of(means))
    chosen = np.empty((len(sets), SUPPORT, 3))
    for index, members in enumerate(sets):
        points = primitives.positions[members].reshape(-1, 3)
        chosen[index] = points[(points @ directions[index].T).argmax(axis=0)]
    return chosen
