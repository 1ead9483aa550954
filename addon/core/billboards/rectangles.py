"""Rectangles in a plane: the smallest one around points, and the part of one that is worth its area."""

from functools import reduce

import numpy as np
from scipy.spatial import ConvexHull, QhullError


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Corners (H, 2) of the convex hull of `points` (N, 2), counter-clockwise. Points on one line come back as their two ends."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        centred = points - points.mean(axis=0)
        along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
        return points[[along.argmin(), along.argmax()]]


def smallest_rectangle(points: np.ndarray) -> np.ndarray:
    """Axes (2, 2) of the minimum-area rectangle around `points` (N, 2): rows are unit u and v, u along the longer side, det +1.

    One side of the smallest rectangle lies on an edge of the convex hull (Freeman and Shapira 1975).
    """
    hull = convex_hull(points)
    edges = np.roll(hull, -1, axis=0) - hull
    lengths = np.linalg.norm(edges, axis=1)
    edges = edges[lengths > 0.0] / lengths[lengths > 0.0, None]
    if len(edges) == 0:
        return np.eye(2)
    across = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    widths, heights = np.ptp(hull @ edges.T, axis=0), np.ptp(hull @ across.T, axis=0)
    best = (widths * heights).argmin()
    if widths[best] >= heights[best]:
        return np.stack([edges[best], across[best]])
    return np.stack([across[best], -edges[best]])


def nearly_smallest_rectangle(points: np.ndarray) -> np.ndarray:
    """Like `smallest_rectangle`, from a few fixed angles: within 2 degrees of the best, several times faster."""
    sizes = np.ptp(points @ _TURNS, axis=0)
    best = int((sizes[:_ANGLES] * sizes[_ANGLES:]).argmin())
    axes = _TURNS[:, [best, best + _ANGLES]].T
    return axes if sizes[best] >= sizes[best + _ANGLES] else np.stack([axes[1], -axes[0]])


_ANGLES = 24
_TURN = np.arange(_ANGLES) * (0.5 * np.pi / _ANGLES)
_TURNS = np.stack([np.concatenate([np.cos(_TURN), -np.sin(_TURN)]), np.concatenate([np.sin(_TURN), np.cos(_TURN)])])


def bounds_of(positions: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Bounds (K, 4) u_min, u_max, v_min, v_max of pieces with corner `positions` (K, C, 3) along `axes` (2, 3)."""
    local = positions @ axes.T
    corners = [local[:, corner] for corner in range(local.shape[1])]  # one by one: NumPy is slow along short axes
    bounds = np.empty((len(local), 4))
    bounds[:, 0::2] = reduce(np.minimum, corners)
    bounds[:, 1::2] = reduce(np.maximum, corners)
    return bounds


def around(bounds: np.ndarray) -> np.ndarray:
    """The rectangle (4,) around all `bounds` (K, 4)."""
    return np.array([bounds[:, 0].min(), bounds[:, 1].max(), bounds[:, 2].min(), bounds[:, 3].max()])


def area(rectangle: np.ndarray) -> float:
    """Area of u_min, u_max, v_min, v_max."""
    return float((rectangle[1] - rectangle[0]) * (rectangle[3] - rectangle[2]))


def inside(bounds: np.ndarray, rectangle: np.ndarray) -> np.ndarray:
    """Which `bounds` (K, 4) lie in `rectangle` (4,): (K,) bool, with a little room for rounding."""
    room = 1e-9 * max(rectangle[1] - rectangle[0], rectangle[3] - rectangle[2])
    return (
        (bounds[:, 0] >= rectangle[0] - room)
        & (bounds[:, 1] <= rectangle[1] + room)
        & (bounds[:, 2] >= rectangle[2] - room)
        & (bounds[:, 3] <= rectangle[3] + room)
    )


def worthwhile_part(bounds: np.ndarray, areas: np.ndarray, fixed_cost: float) -> tuple[float, np.ndarray]:
    """The pieces that a rectangle should hold: sides move inwards as long as covered area per cost rises.

    Cost is `fixed_cost` (an area: what one more quad is worth) plus the area of the rectangle. Slivers that would drag a rectangle far
    out are thus left for another quad.

    Args:
        bounds: (K, 4) bounds of the pieces. areas: (K,) what each is worth.

    Returns:
        worth: covered area over cost; indices (K',) of the pieces that stay.
    """
    keys = bounds.T * _OUTWARD
    orders = np.argsort(keys, axis=1)
    kept = np.ones(len(bounds), bool)
    worth = float(areas.sum() / (fixed_cost + area(around(bounds))))
    while orders.shape[1] > 1:
        cut_worth, stay = _best_cut(keys, orders, areas, fixed_cost)
        if cut_worth <= worth * (1.0 + 1e-9):
            break
        worth = cut_worth
        kept = np.zeros(len(bounds), bool)
        kept[stay] = True
        orders = orders[kept[orders]].reshape(4, -1)
    return worth, np.flatnonzero(kept)


def _best_cut(keys: np.ndarray, order: np.ndarray, areas: np.ndarray, fixed_cost: float) -> tuple[float, np.ndarray]:
    """The best side, and place, to move one side inwards to: worth, indices of the pieces that stay inside.

    keys (4, K): how far each piece reaches to each side. order (4, L): those still inside by each of them, ascending.
    """
    high = np.maximum.accumulate(keys[:, order], axis=2)  # [side of the box, side that moves, pieces kept]
    worth = np.cumsum(areas[order], axis=1) / (fixed_cost + (high[0] + high[1]) * (high[2] + high[3]))
    side, place = divmod(int(worth.argmax()), order.shape[1])
    return float(worth[side, place]), order[side, : place + 1]


_OUTWARD = np.array([[-1.0], [1.0], [-1.0], [1.0]])  # u_min, u_max, v_min, v_max: a box grows where these grow
