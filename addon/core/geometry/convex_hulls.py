"""Convex hulls of points in a plane."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Return the corners (H, 2) of the convex hull of `points` (N, 2), counter-clockwise; of points on one line, the two ends."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        centered = points - points.mean(axis=0)
        along = centered @ np.linalg.svd(centered, full_matrices=False)[2][0]
        return points[[along.argmin(), along.argmax()]]
