"""Costs of half-edge collapses in a height field: vertical distances from what is removed to the new triangles.

A collapse moves a vertex onto one of its neighbors, the target. Its star is replaced by a fan of triangles around the target, which is valid
if all of them are counterclockwise in the plane.
"""

from dataclasses import dataclass

import numpy as np

from .vertex_rings import VertexRings

FREE, HORIZONTAL, VERTICAL, DIAGONAL, ANTIDIAGONAL, LOCKED = range(6)  # what a vertex may move along
DIRECTIONS = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (1, -1), (0, 0)], np.int32)


@dataclass(frozen=True)
class GridPoints:
    """Samples of a height field.

    x, y: (V,) int32, grid coordinates. z: (V,) float32, heights in any unit. real: the dtype in which products of coordinate differences
    are exact.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    real: np.dtype


def find_targets(points: GridPoints, rings: VertexRings, lines: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find for each vertex the valid target with the least vertical distance from the vertex to the new triangles.

    Args:
        lines: (V,) int8, FREE or the line along which a vertex may move. vertices: (N,) int32.

    Returns:
        Targets (N,) int32 and distances (N,) float32, infinite where no target is valid.
    """
    targets, costs = np.zeros(len(vertices), np.int32), np.full(len(vertices), np.inf, np.float32)
    for positions, corners in rings.group_by_degree(vertices):
        v = vertices[positions]
        after, before = rings.next[corners], rings.previous[corners]
        ax, ay, az = _differences(points, after, v)
        bx, by, bz = _differences(points, before, v)
        areas = ax * by - ay * bx
        line_x, line_y = (component.astype(points.real) for component in DIRECTIONS[lines[v]].T)
        best_cost, best_target = np.full(len(v), np.inf, np.float32), np.zeros(len(v), np.int32)
        for target, x, y, z in zip(after, ax, ay, az, strict=True):
            to_after, to_before = x * ay - y * ax, x * by - y * bx
            new_areas = areas + to_after - to_before
            kept = (after != target) & (before != target)
            is_valid = ((new_areas > 0) | ~kept).all(axis=0) & (line_x * y == line_y * x)
            contains = kept & (to_after >= 0) & (to_before <= 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                heights = (areas * z - to_before * az + to_after * bz) / new_areas
            cost = np.where(contains, np.abs(heights), 0.0).max(axis=0)
            is_better = is_valid & (cost < best_cost)
            best_cost = np.where(is_better, cost, best_cost)
            best_target = np.where(is_better, target, best_target)
        targets[positions], costs[positions] = best_target, best_cost
    return targets, costs


def locate_in_fans(
    points: GridPoints, rings: VertexRings, vertices: np.ndarray, targets: np.ndarray, samples: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Locate samples in the stars of vertices after the collapse of these vertices.

    Args:
        vertices, targets, samples: (N,) int32. Each sample lies in the star of its vertex.

    Returns:
        Corners (N,) int32 of the vertex, whose triangle contains the sample once its corner is the target, and vertical distances (N,)
        float32 from the sample to this triangle.
    """
    corners_found, distances = np.full(len(vertices), -1, np.int32), np.full(len(vertices), np.inf, np.float32)
    for positions, corners in rings.group_by_degree(vertices):
        u, s = targets[positions], samples[positions]
        after, before = rings.next[corners], rings.previous[corners]
        ax, ay, az = _differences(points, after, u)
        bx, by, bz = _differences(points, before, u)
        sx, sy, sz = _differences(points, s, u)
        after_side, before_side = ax * sy - ay * sx, bx * sy - by * sx
        areas = ax * by - ay * bx
        contains = (after_side >= 0) & (before_side <= 0) & (areas > 0)
        row, column = contains.argmax(axis=0), np.arange(len(u))
        heights = (after_side[row, column] * bz[row, column] - before_side[row, column] * az[row, column]) / areas[row, column]
        found = contains[row, column]
        corners_found[positions] = np.where(found, corners[row, column], -1)
        distances[positions] = np.where(found, np.abs(heights - sz), np.inf)
    return corners_found, distances


def _differences(points: GridPoints, ends: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the vectors from `starts` (N,) to `ends` (K, N) or (N,)."""
    x = (points.x[ends] - points.x[starts]).astype(points.real)
    y = (points.y[ends] - points.y[starts]).astype(points.real)
    return x, y, points.z[ends] - points.z[starts]
