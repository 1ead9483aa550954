"""Polygons that quads are cut to, so that less of what is transparent is drawn."""

import numpy as np

SLOPES = np.linspace(0.1, 0.9, 17)  # share of x in the direction that cuts a corner off
WORTH = 0.005  # a cut of less than this share of the rectangle is left


def cut_corners(points: np.ndarray, room: np.ndarray, most_corners: int) -> np.ndarray:
    """A convex polygon with at most `most_corners` around `points`: the square -1..1 with its corners cut off where that saves most.

    Args:
        points: (N, 2) in -1..1. room: (2,) that stays free around the points, for the texture filter.
        most_corners: 4 to 8.

    Returns:
        (C, 2) float64, counter-clockwise.
    """
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    cuts = []
    for corner in square:
        reach = (np.abs(corner)[None] * np.column_stack([SLOPES, 1.0 - SLOPES])) * corner
        limits = (points @ reach.T).max(axis=0) + np.abs(reach) @ room
        saved = np.maximum(1.0 - limits, 0.0) ** 2 / (2.0 * SLOPES * (1.0 - SLOPES))
        best = saved.argmax()
        cuts.append((saved[best], reach[best], limits[best]))
    cuts.sort(key=lambda cut: -cut[0])
    polygon = square
    for saved, direction, limit in cuts[: most_corners - 4]:
        if saved > 4.0 * WORTH:
            polygon = _clip(polygon, direction, limit)
    return polygon


def _clip(polygon: np.ndarray, direction: np.ndarray, limit: float) -> np.ndarray:
    """The part of a convex `polygon` with direction . p <= limit (Sutherland and Hodgman 1974)."""
    heights = polygon @ direction - limit
    corners = []
    for index, height in enumerate(heights):
        after = (index + 1) % len(polygon)
        if height <= 0.0:
            corners.append(polygon[index])
        if height * heights[after] < 0.0:
            share = height / (height - heights[after])
            corners.append(polygon[index] + share * (polygon[after] - polygon[index]))
    return np.array(corners)
