"""Polygons that quads are cut to, so that fewer transparent pixels are drawn."""

import numpy as np

CORNER_CUT_DIRECTIONS = np.linspace(0.1, 0.9, 17)  # x component of the normal of a corner cut; its y component is the rest to 1
MIN_CUT_FRACTION = 0.005  # of the rectangle's area; smaller cuts are not made


def cut_corners(points: np.ndarray, margin: np.ndarray, max_corners: int) -> np.ndarray:
    """Compute a convex polygon around `points`: the square -1..1 with the corners cut off that save most area.

    Args:
        points: (N, 2) in -1..1.
        margin: (2,) distance along each axis that the cuts keep from the points, for the texture filter.
        max_corners: 4 to 8.

    Returns:
        (C, 2) float64, counter-clockwise, C at most `max_corners`.
    """
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    cuts = []
    for corner in square:
        directions = (np.abs(corner)[None] * np.column_stack([CORNER_CUT_DIRECTIONS, 1.0 - CORNER_CUT_DIRECTIONS])) * corner
        limits = (points @ directions.T).max(axis=0) + np.abs(directions) @ margin
        saved_areas = np.maximum(1.0 - limits, 0.0) ** 2 / (2.0 * CORNER_CUT_DIRECTIONS * (1.0 - CORNER_CUT_DIRECTIONS))
        best = saved_areas.argmax()
        cuts.append((saved_areas[best], directions[best], limits[best]))
    cuts.sort(key=lambda cut: -cut[0])
    polygon = square
    for saved_area, direction, limit in cuts[: max_corners - 4]:
        if saved_area > 4.0 * MIN_CUT_FRACTION:
            polygon = _clip(polygon, direction, limit)
    return polygon


def _clip(polygon: np.ndarray, direction: np.ndarray, limit: float) -> np.ndarray:
    """Clip a convex `polygon` to the half plane direction . p <= limit (Sutherland and Hodgman 1974)."""
    heights = polygon @ direction - limit
    corners = []
    for index, height in enumerate(heights):
        following = (index + 1) % len(polygon)
        if height <= 0.0:
            corners.append(polygon[index])
        if height * heights[following] < 0.0:
            t = height / (height - heights[following])
            corners.append(polygon[index] + t * (polygon[following] - polygon[index]))
    return np.array(corners)
