"""Rectangles in a plane: the smallest one around points, and the crop with the most covered area per cost.

A rectangle is an array (4,) u_min, u_max, v_min, v_max.
"""

from functools import reduce

import numpy as np

from ...geometry.convex_hulls import convex_hull

ANGLE_COUNT = 24  # Rotations that `approximate_min_area_axes` tests, over a quarter turn.
INSIDE_TOLERANCE = 1e-9  # Tolerance for rounding, relative to the longer side of a rectangle.
MIN_WORTH_GAIN = 1e-9  # Relative gain of a crop that is not just rounding.
OUTWARD = np.array([[-1.0], [1.0], [-1.0], [1.0]])  # Signs of u_min, u_max, v_min, v_max: a rectangle grows if these products grow.


def min_area_axes(points: np.ndarray) -> np.ndarray:
    """Compute the axes (2, 2) of the minimum-area rectangle around `points` (N, 2): rows are unit u and v, u along the longer side, det +1.

    One side of this rectangle contains an edge of the convex hull (Freeman and Shapira 1975).
    """
    hull = convex_hull(points)
    edges = np.roll(hull, -1, axis=0) - hull
    lengths = np.linalg.norm(edges, axis=1)
    edges = edges[lengths > 0.0] / lengths[lengths > 0.0, None]
    if len(edges) == 0:
        return np.eye(2)
    perpendicular = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    widths, heights = np.ptp(hull @ edges.T, axis=0), np.ptp(hull @ perpendicular.T, axis=0)
    best = (widths * heights).argmin()
    if widths[best] >= heights[best]:
        return np.stack([edges[best], perpendicular[best]])
    return np.stack([perpendicular[best], -edges[best]])


def approximate_min_area_axes(points: np.ndarray) -> np.ndarray:
    """Compute axes like `min_area_axes` from a few fixed angles: within 2 degrees of the best, several times faster."""
    sizes = np.ptp(points @ _AXES, axis=0)
    best = int((sizes[:ANGLE_COUNT] * sizes[ANGLE_COUNT:]).argmin())
    axes = _AXES[:, [best, best + ANGLE_COUNT]].T
    return axes if sizes[best] >= sizes[best + ANGLE_COUNT] else np.stack([axes[1], -axes[0]])


_ANGLES = np.arange(ANGLE_COUNT) * (0.5 * np.pi / ANGLE_COUNT)
_AXES = np.stack([np.concatenate([np.cos(_ANGLES), -np.sin(_ANGLES)]), np.concatenate([np.sin(_ANGLES), np.cos(_ANGLES)])])


def compute_bounds(positions: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Compute the bounds (K, 4) u_min, u_max, v_min, v_max along `axes` (2, 3) of primitives with corner `positions` (K, C, 3)."""
    return bounds_of_corners(positions @ axes.T)


def bounds_of_corners(local: np.ndarray) -> np.ndarray:
    """Return the bounds (K, 4) of primitives with the corners `local` (K, C, 2)."""
    corners = [local[:, corner] for corner in range(local.shape[1])]  # Separately, because NumPy is slow along short axes.
    bounds = np.empty((len(local), 4))
    bounds[:, 0::2] = reduce(np.minimum, corners)
    bounds[:, 1::2] = reduce(np.maximum, corners)
    return bounds


def enclosing_rectangle(bounds: np.ndarray) -> np.ndarray:
    """Return the rectangle (4,) around all `bounds` (K, 4)."""
    return np.array([bounds[:, 0].min(), bounds[:, 1].max(), bounds[:, 2].min(), bounds[:, 3].max()])


def fit_rectangle(points: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the axes (2, 3) and bounds (4,) of the smallest rectangle around `points` (N, 3) in the plane of `frame` (2, 3)."""
    axes = min_area_axes(points @ frame.T) @ frame
    return axes, enclosing_rectangle(compute_bounds(points[:, None], axes))


def rectangle_area(rectangle: np.ndarray) -> float:
    """Return the area of `rectangle` (4,)."""
    return float((rectangle[1] - rectangle[0]) * (rectangle[3] - rectangle[2]))


def is_inside(bounds: np.ndarray, rectangle: np.ndarray) -> np.ndarray:
    """Test which `bounds` (K, 4) are inside `rectangle` (4,), up to rounding: (K,) bool."""
    tolerance = INSIDE_TOLERANCE * max(rectangle[1] - rectangle[0], rectangle[3] - rectangle[2])
    return (
        (bounds[:, 0] >= rectangle[0] - tolerance)
        & (bounds[:, 1] <= rectangle[1] + tolerance)
        & (bounds[:, 2] >= rectangle[2] - tolerance)
        & (bounds[:, 3] <= rectangle[3] + tolerance)
    )


def crop_rectangle(bounds: np.ndarray, areas: np.ndarray, fixed_cost: float) -> tuple[float, np.ndarray]:
    """Choose the primitives that a rectangle should contain: its sides move inwards while the covered area per cost rises.

    The cost is `fixed_cost` (the cost of one more quad, as an area) plus the area of the rectangle. Slivers that would enlarge a rectangle
    considerably are thus left to another quad.

    Args:
        bounds: (K, 4) of the primitives. areas: (K,) covered by each.

    Returns:
        The covered area over the cost, and the indices (K',) of the primitives inside.
    """
    keys = bounds.T * OUTWARD
    orders = np.argsort(keys, axis=1)
    kept = np.ones(len(bounds), bool)
    worth = float(areas.sum() / (fixed_cost + rectangle_area(enclosing_rectangle(bounds))))
    while orders.shape[1] > 1:
        new_worth, remaining = _find_best_cut(keys, orders, areas, fixed_cost)
        if new_worth <= worth * (1.0 + MIN_WORTH_GAIN):
            break
        worth = new_worth
        kept = np.zeros(len(bounds), bool)
        kept[remaining] = True
        orders = orders[kept[orders]].reshape(4, -1)
    return worth, np.flatnonzero(kept)


def _find_best_cut(keys: np.ndarray, orders: np.ndarray, areas: np.ndarray, fixed_cost: float) -> tuple[float, np.ndarray]:
    """Find the side to move inwards, and where to: its worth, and the indices of the primitives that remain inside.

    keys (4, K): extent of each primitive towards each side. orders (4, L): the primitives still inside, sorted by each of them.
    """
    extents = np.maximum.accumulate(keys[:, orders], axis=2)  # [side of the rectangle, side that moves, number of primitives kept].
    worth = np.cumsum(areas[orders], axis=1) / (fixed_cost + (extents[0] + extents[1]) * (extents[2] + extents[3]))
    side, last = divmod(int(worth.argmax()), orders.shape[1])
    return float(worth[side, last]), orders[side, : last + 1]
