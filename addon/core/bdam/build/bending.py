"""How far triangles in the local frame are from triangles in the grid, where the grid is one of longitudes and latitudes."""

import numpy as np

from .patch_set import PatchSet


def measure_bending(patches: PatchSet, curvature: float) -> np.ndarray:
    """Return upper bounds (P,) float32, in steps, of the vertical distances of patches in the local frame to the same patches in the grid.

    A point with the barycentric coordinates w in a triangle of the grid, and the point with the same coordinates in the triangle whose
    vertices were projected, are at most half of the curvature times the sum of w_i |v_i - p|^2 apart (Taylor's theorem), and that sum is at
    most a third of the square of the longest edge. The height changes by that distance times the gradient. Close to an edge, the gradient
    may be that of the other triangle; so the largest one around the vertices is used.

    Args:
        curvature: in cells per square cell, see `measure_curvature` of frames.
    """
    if not curvature:
        return np.zeros(len(patches.indices), np.float32)
    starts = np.repeat(patches.vertex_starts[:-1], np.diff(patches.triangle_starts))
    vertices = patches.triangles + starts[:, None]
    (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = (axis.astype(np.float64)[vertices.T] for axis in (patches.x, patches.y, patches.z))
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    along_x = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / area
    along_y = ((z2 - z0) * (x1 - x0) - (z1 - z0) * (x2 - x0)) / area
    gradients = np.hypot(along_x, along_y)
    around = np.zeros(len(patches.x))
    np.maximum.at(around, vertices, gradients[:, None])
    squares = np.maximum((x1 - x0) ** 2 + (y1 - y0) ** 2, (x2 - x1) ** 2 + (y2 - y1) ** 2)
    squares = np.maximum(squares, (x0 - x2) ** 2 + (y0 - y2) ** 2)
    bounds = around[vertices].max(axis=1) * (curvature / 6.0) * squares
    return np.maximum.reduceat(bounds, patches.triangle_starts[:-1]).astype(np.float32)
