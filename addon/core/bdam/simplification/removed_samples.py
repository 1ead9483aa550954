"""Samples that were removed from a mesh. They remember the triangle that contains them, so that errors do not accumulate unseen."""

from dataclasses import dataclass

import numpy as np

from ...arrays import gather
from ...geometry.vertex_rings import to_triangles
from .collapse_costs import GridPoints
from .collapsed_fans import CollapsedFans


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
