"""Samples that were removed from a mesh. They remember the triangle that contains them, so that errors do not accumulate unseen."""

import numpy as np

from .collapse_costs import GridPoints, locate_in_fans
from .vertex_rings import VertexRings


class RemovedSamples:
    """Removed vertices of a mesh with numbered triangles.

    vertices: (S,) int32. triangles: (S,) int32, rows of the triangle array that contain them.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self.vertices = vertices
        self.triangles = triangles

    def raise_costs(
        self, points: GridPoints, rings: VertexRings, triangles: np.ndarray, vertices: np.ndarray, targets: np.ndarray, costs: np.ndarray
    ) -> np.ndarray:
        """Return the `costs` (N,) of collapsing `vertices` (N,) onto `targets` (N,), raised to the largest distance of a sample in their stars.

        triangles: (T, 3) int32, the triangles that `self.triangles` and the corners in `rings` refer to.
        """
        positions = np.full(len(points.x), -1, np.int32)
        positions[vertices] = np.arange(len(vertices), dtype=np.int32)
        costs = costs.copy()
        owners = positions[triangles[self.triangles]]
        rows, corners = np.nonzero(owners >= 0)
        owners = owners[rows, corners]
        _, distances = locate_in_fans(points, rings, vertices, targets, owners, self.vertices[rows])
        np.maximum.at(costs, owners, distances)
        return costs

    def update(self, points: GridPoints, rings: VertexRings, triangles: np.ndarray, removed: np.ndarray, targets: np.ndarray) -> None:
        """Add the `removed` vertices (N,) int32, which collapse onto `targets` (N,), and move the samples in their stars.

        Call it before `triangles` (T, 3) int32 are changed. No two of the removed vertices share a triangle.
        """
        positions = np.full(len(points.x), -1, np.int32)
        positions[removed] = np.arange(len(removed), dtype=np.int32)
        owners = positions[triangles[self.triangles]].max(axis=1, initial=-1)
        affected = np.flatnonzero(owners >= 0)
        owners = np.concatenate([owners[affected], np.arange(len(removed), dtype=np.int32)])
        samples = np.concatenate([self.vertices[affected], removed])
        corners, _ = locate_in_fans(points, rings, removed, targets, owners, samples)
        kept = self.triangles.copy()
        kept[affected] = corners[: len(affected)] // 3
        self.vertices = np.concatenate([self.vertices, removed])
        self.triangles = np.concatenate([kept, corners[len(affected) :] // 3])
