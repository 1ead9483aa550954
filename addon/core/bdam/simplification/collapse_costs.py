"""Costs of half-edge collapses in a height field: vertical distances from what is removed to the new triangles.

A collapse moves a vertex onto one of its neighbors, the target. Its star is replaced by a fan of triangles around the target, which is valid
if all of them are counterclockwise in the plane.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import concatenate_ranges
from .vertex_rings import VertexRings

FREE, HORIZONTAL, VERTICAL, DIAGONAL, ANTIDIAGONAL, LOCKED = range(6)  # what a vertex may move along
CHUNK_SAMPLES = 1 << 13  # samples that are located at once
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
    points: GridPoints, rings: VertexRings, vertices: np.ndarray, targets: np.ndarray, owners: np.ndarray, samples: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Locate samples in the stars of vertices after the collapse of these vertices.

    Args:
        vertices, targets: (V,) int32. samples: (N,) int32. owners: (N,) int, the position in `vertices` of the one whose star contains the
            sample.

    Returns:
        Corners (N,) int32 of the owner, whose triangle contains the sample once its corner is the target, and vertical distances (N,)
        float32 from the sample to this triangle.
    """
    corners_found, distances = np.empty(len(samples), np.int32), np.empty(len(samples), np.float32)
    order = np.argsort(owners, kind="stable")
    starts = np.searchsorted(owners[order], np.arange(len(vertices) + 1))
    for positions, corners in rings.group_by_degree(vertices):
        counts = starts[positions + 1] - starts[positions]
        members = order[concatenate_ranges(starts[positions], counts)]
        if not len(members):
            continue
        u = targets[positions]
        corners = _order_fans(rings, corners, u)
        rays = np.concatenate([rings.next[corners], rings.previous[corners[-1:]]])
        ray_x, ray_y, ray_z = _differences(points, rays, u)
        local = np.repeat(np.arange(len(positions)), counts)
        for first in range(0, len(members), CHUNK_SAMPLES):
            of_fan, part = local[first : first + CHUNK_SAMPLES], members[first : first + CHUNK_SAMPLES]
            x, y, z = _differences(points, samples[part], u[of_fan])
            sides = ray_x[1:, of_fan] * y - ray_y[1:, of_fan] * x  # the first ray ends at the target and has no length
            sector = ((sides[:-1] >= 0) & (sides[1:] <= 0)).argmax(axis=0)
            columns = np.arange(len(part))
            a, b = (sector + 1, of_fan), (sector + 2, of_fan)
            area = ray_x[a] * ray_y[b] - ray_y[a] * ray_x[b]
            heights = (sides[sector, columns] * ray_z[b] - sides[sector + 1, columns] * ray_z[a]) / area
            corners_found[part], distances[part] = corners[a], np.abs(heights - z)
    return corners_found, distances


def _order_fans(rings: VertexRings, corners: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the corners (K, V) of vertices in counterclockwise order, from the triangle after the edge to the target (V,)."""
    after, before = rings.next[corners], rings.previous[corners]
    columns = np.arange(corners.shape[1])
    ordered = np.empty_like(corners)
    ray = targets
    for row in range(len(corners)):
        found = (after == ray).argmax(axis=0)
        ordered[row], ray = corners[found, columns], before[found, columns]
    return ordered


def _differences(points: GridPoints, ends: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the vectors from `starts` (N,) to `ends` (K, N) or (N,)."""
    x = (points.x[ends] - points.x[starts]).astype(points.real)
    y = (points.y[ends] - points.y[starts]).astype(points.real)
    return x, y, points.z[ends] - points.z[starts]
