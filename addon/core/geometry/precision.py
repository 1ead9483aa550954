"""Meshes far from their origin: positions to compute with, and what single precision has lost of them."""

import numpy as np

MAX_RATIO = 1000.0  # Distance from the origin over size; beyond, sums of squares in double precision lose what decides ties.
MIN_SPACING = 1e-6  # Relative to the size of a mesh; single precision has smaller steps near the origin.
MAX_SPACING = 0.01  # Relative to the median edge; beyond, the shapes of triangles change visibly.


def choose_local_origin(points: np.ndarray) -> np.ndarray:
    """Return the position (3,) float64 that computations with `points` (N, 3) should be relative to: zero, unless they are so far from it
    that precision would be lost. Differences to it and their sums with it are exact for points in single precision."""
    with np.errstate(over="ignore", invalid="ignore"):  # Points that are not finite are reported elsewhere.
        center = 0.5 * (points.min(axis=0).astype(np.float64) + points.max(axis=0))
        is_far = bool(np.abs(center).max() > MAX_RATIO * np.ptp(points.astype(np.float64), axis=0).max())
    return center.astype(np.float32).astype(np.float64) if is_far and np.isfinite(center).all() else np.zeros(3)


def describe_rounding(name: str, vertices: np.ndarray, triangles: np.ndarray) -> str:
    """Return a sentence if vertices (V, 3) float32 are so far from the origin of their object `name` that single precision has moved them
    visibly, "" if not. triangles: (T, 3)."""
    if not len(triangles) or not np.isfinite(vertices).all():
        return ""
    spacing = float(np.spacing(np.abs(vertices).max().astype(np.float32)))
    if spacing <= MIN_SPACING * float(np.ptp(vertices.astype(np.float64), axis=0).max()):
        return ""
    corners = vertices[triangles].astype(np.float64)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    if spacing <= MAX_SPACING * float(np.median(edges)):
        return ""
    return (
        f'The vertices of "{name}" are so far from its origin that single precision rounds them to {spacing:g}; move the mesh to its '
        "origin in the program that it comes from."
    )
