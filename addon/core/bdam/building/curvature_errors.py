"""How far triangles in the local frame are from triangles in the grid, where the grid is one of longitudes and latitudes."""

import numpy as np

from ..height_meshes import weigh_gradients
from .patch_set import PatchSet


def bound_curvature_errors(patches: PatchSet, curvature: float) -> np.ndarray:
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
    x, y, z = (axis.astype(np.float64)[vertices.T] for axis in (patches.x, patches.y, patches.z))
    along_x, along_y, area = weigh_gradients(x, y, z)
    around = np.zeros(len(patches.x))
    np.maximum.at(around, vertices, np.hypot(along_x / area, along_y / area)[:, None])
    edges = np.stack([x - np.roll(x, 1, axis=0), y - np.roll(y, 1, axis=0)])
    longest_squares = (edges**2).sum(axis=0).max(axis=0)
    bounds = around[vertices].max(axis=1) * (curvature / 6.0) * longest_squares
    return np.maximum.reduceat(bounds, patches.triangle_starts[:-1]).astype(np.float32)
