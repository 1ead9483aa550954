"""Fans of triangles that replace the stars of collapsed vertices, and the samples that were removed before.

Removed samples remember the triangle that contains them, so that errors do not accumulate unseen.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import gather
from ...geometry.vertex_rings import VertexRings, to_triangles
from .collapse_costs import GridPoints

ROW_LENGTH = 24  # columns of the arrays of fans; a fan has fewer than MAX_DEGREE triangles
SEARCH_STEPS = (8, 8, 4, 2, 1)
MAX_ENTRIES = 1 << 16  # entries of a (degree, vertices) array
MAX_SAMPLES = 1 << 13  # samples that are located at once


@dataclass(frozen=True)
class CollapsedFans:
    """The fans of triangles around the targets (N,) of collapsed vertices, counterclockwise, in rows of ROW_LENGTH.

    Attributes:
        vertices, targets: (N,) intp.
        corners: (N, 24) intp, corners of the vertices whose triangles become those of the fan.
        owners: (C,) intp, positions of the vertices of all corners of their stars.
        star: (C,) intp, all corners of the stars.
        is_kept: (C,) bool, whether the triangle of a corner becomes one of the fan; the others vanish.
        x, y, z: (N, 24), the vectors from the target to the ends of its rays, of which there is one more than triangles.
        angles: (N, 24), `_pseudo_angles` of the rays from the second to the one before the last, then infinity.
    """

    vertices: np.ndarray
    targets: np.ndarray
    corners: np.ndarray
    owners: np.ndarray
    star: np.ndarray
    is_kept: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    angles: np.ndarray

    def locate(self, points: GridPoints, owners: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Locate samples in the fans of the vertices whose stars contain them.

        Args:
            owners: (S,) intp, positions of these vertices. samples: (S,) intp.

        Returns:
            Corners (S,) intp of the owner, whose triangle contains the sample once its corner is the target, and vertical distances (S,)
            float32 from the sample to this triangle.
        """
        corners, distances = np.empty(len(samples), np.intp), np.empty(len(samples), np.float32)
        away_x, away_y, _ = points.subtract(self.vertices, self.targets)
        angles, fan_corners, ray_x, ray_y, ray_z = (rows.reshape(-1) for rows in (self.angles, self.corners, self.x, self.y, self.z))
        for first in range(0, len(samples), MAX_SAMPLES):
            part = slice(first, first + MAX_SAMPLES)
            owner = owners[part]
            x, y, z = points.subtract(samples[part], gather(self.targets, owner))
            angle = _pseudo_angles(x, y, gather(away_x, owner), gather(away_y, owner))
            ray = owner * ROW_LENGTH
            for step in SEARCH_STEPS:
                ray += step * (gather(angles, ray + (step - 1)) < angle)
            after = ray + 1
            ax, ay, bx, by = gather(ray_x, ray), gather(ray_y, ray), gather(ray_x, after), gather(ray_y, after)
            heights = ((x * by - y * bx) * gather(ray_z, ray) + (ax * y - ay * x) * gather(ray_z, after)) / (ax * by - ay * bx)
            corners[part], distances[part] = gather(fan_corners, ray), np.abs(heights - z)
        return corners, distances


def arrange_fans(points: GridPoints, rings: VertexRings, vertices: np.ndarray, targets: np.ndarray) -> CollapsedFans:
    """Arrange the fans that replace the stars of `vertices` (N,) intp after valid collapses onto `targets` (N,) intp."""
    shape = (len(vertices), ROW_LENGTH)
    corner_rows = np.zeros(shape, np.intp)
    xyz = [np.zeros(shape, dtype) for dtype in (points.real, points.real, np.float32)]
    angles = np.full(shape, np.inf, points.real)
    owners, star, is_kept = [], [], []
    for positions, corners in rings.group_by_degree(vertices, MAX_ENTRIES):
        u = gather(targets, positions)
        corners, is_border = _order_corners(rings, corners, u)
        degree = len(corners)
        kept = np.ones(corners.shape, bool)
        kept[0], kept[-1] = False, is_border
        owners.append(np.broadcast_to(positions, corners.shape).reshape(-1))
        star.append(corners.reshape(-1))
        is_kept.append(kept.reshape(-1))
        corner_rows[positions, : degree - 1] = corners[1:].T
        rays = np.concatenate([gather(rings.next, corners[1:]), gather(rings.previous, corners[-1:])])
        components = points.subtract(rays, u)
        for rows, component in zip(xyz, components, strict=True):
            rows[positions, :degree] = component.T
        away_x, away_y, _ = points.subtract(gather(vertices, positions), u)
        inner = _pseudo_angles(components[0][1:-1], components[1][1:-1], away_x, away_y)
        if degree > 2:
            inner[-1, ~is_border] = np.inf  # the last triangle vanishes unless the vertex is on a border
        angles[positions, : degree - 2] = inner.T
    joined = (
        np.concatenate(arrays) if arrays else np.zeros(0, dtype) for arrays, dtype in ((owners, np.intp), (star, np.intp), (is_kept, bool))
    )
    return CollapsedFans(vertices, targets, corner_rows, *joined, *xyz, angles)


def _order_corners(rings: VertexRings, corners: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (K, V) of vertices in counterclockwise order, from the triangle after the edge to the target (V,), and whether the
    vertices are on a border (V,)."""
    after, before = gather(rings.next, corners), gather(rings.previous, corners)
    columns = np.arange(corners.shape[1])
    rows = np.arange(len(corners), dtype=np.int8)[:, None]
    ordered = np.empty_like(corners)
    ray = targets
    for row in range(len(corners)):
        found = np.add.reduce((after == ray).view(np.int8) * rows, axis=0, dtype=np.int8)  # argmax would copy columns one by one
        found = found.astype(np.intp) * len(columns) + columns
        ordered[row], ray = gather(corners.reshape(-1), found), gather(before.reshape(-1), found)
    return ordered, ray != targets


def _pseudo_angles(x: np.ndarray, y: np.ndarray, away_x: np.ndarray, away_y: np.ndarray) -> np.ndarray:
    """Return numbers between -2 and 2 that increase with the angle from the vectors `away` to (x, y)."""
    cross, dot = away_x * y - away_y * x, away_x * x + away_y * y
    with np.errstate(invalid="ignore"):
        quotients = cross / (np.abs(cross) + np.abs(dot))
    return np.where(dot < 0, np.copysign(2, cross).astype(quotients.dtype) - quotients, quotients)


@dataclass(frozen=True)
class LocatedSamples:
    """Samples in the stars of vertices that may collapse.

    samples: (N,) intp, their positions. owners: (N,) intp, positions of the vertices. triangles: (N,) intp, the triangles that contain
    the samples after the collapses. distances: (N,) float32, their vertical distances from these.
    """

    samples: np.ndarray
    owners: np.ndarray
    triangles: np.ndarray
    distances: np.ndarray


class RemovedSamples:
    """Removed vertices of a mesh with numbered triangles.

    vertices: (S,) intp. triangles: (S,) intp, columns of the triangle array that contain them.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self.vertices = vertices
        self.triangles = triangles

    def locate(self, points: GridPoints, fans: CollapsedFans, triangle_count: int) -> LocatedSamples:
        """Locate the samples in the stars of the vertices of `fans`, no two of which share a triangle."""
        owner_of_triangle = np.full(triangle_count, -1, np.int32)
        owner_of_triangle[to_triangles(fans.star, triangle_count)] = fans.owners
        owners = gather(owner_of_triangle, self.triangles)
        samples = np.flatnonzero(owners >= 0)
        owners = gather(owners, samples).astype(np.intp)
        corners, distances = fans.locate(points, owners, gather(self.vertices, samples))
        return LocatedSamples(samples, owners, to_triangles(corners, triangle_count), distances)

    def move(self, located: LocatedSamples, is_accepted: np.ndarray) -> None:
        """Move those samples whose owners collapse, according to `is_accepted` (V,) bool."""
        is_moved = gather(is_accepted, located.owners)
        self.triangles[located.samples.compress(is_moved)] = located.triangles.compress(is_moved)

    def add(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        """Add removed vertices (N,) intp, which `triangles` (N,) intp contain."""
        self.vertices = np.concatenate([self.vertices, vertices])
        self.triangles = np.concatenate([self.triangles, triangles])
