"""Planes through sets of primitives: the one whose largest distance to their corners is least."""

import numpy as np

from ..directions import fibonacci_sphere
from .primitives import Primitives

SUPPORT = 64  # extreme points of a set that the fit looks at
ROUNDS = 40  # of Lawson's reweighting; it gains little after 30


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
    weights = np.full(points.shape[:2], 1.0 / SUPPORT)
    best = np.full(len(sets), np.inf)
    normals, offsets = means.copy(), np.zeros(len(sets))
    for _ in range(ROUNDS):
        weights /= weights.sum(axis=1, keepdims=True)
        centred = points - np.einsum("qs,qsi->qi", weights, points)[:, None]
        axes = np.linalg.eigh(np.einsum("qs,qsi,qsj->qij", weights, centred, centred, optimize=True))[1]
        normal = axes[:, :, 0]
        heights = np.einsum("qsi,qi->qs", points, normal)
        low, high = heights.min(axis=1), heights.max(axis=1)
        better = high - low < best * (1.0 - 1e-12)
        best[better] = (high - low)[better]
        normals[better] = normal[better]
        offsets[better] = 0.5 * (high + low)[better]
        weights *= np.abs(heights - 0.5 * (high + low)[:, None]) + 1e-3 * (high - low)[:, None] + 1e-300
    sign = np.where(np.einsum("qi,qi->q", normals, means) < 0.0, -1.0, 1.0)
    return normals * sign[:, None], offsets * sign


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
