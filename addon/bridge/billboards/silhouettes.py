"""Where the surface that a quad shows continues past the quad's silhouette.

There the silhouette may grow to close cracks; elsewhere growing would make a trunk thicker.
"""

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ...core.billboards.cloud import Level
from ...core.billboards.texels import interpolate_in_triangles
from ...core.imaging.images import MIN_ALPHA, max_of_neighbors
from ..geometry.meshes import Source
from .atlas_meshes import compute_placement

MAX_HEIGHT = 2.0  # Errors above and below the plane of a quad in which its surface is searched.


class SurfaceContinuation:
    """Finds the surface of `source` next to the silhouettes of its quads by ray casting."""

    def __init__(self, source: Source) -> None:
        self._mesh = source.mesh
        self._bvh: BVHTree | None = None

    def find_texels(self, level: Level, alphas: list[np.ndarray]) -> np.ndarray:
        """Return a mask (H, W) bool of the texels of joined quads on or next to the silhouette of one of `alphas` (H, W) where the
        surface continues."""
        candidates = np.zeros(alphas[0].shape, bool)
        for alpha in alphas:
            candidates |= (alpha < 1.0 - MIN_ALPHA) & (max_of_neighbors(alpha, level.atlas.quad_map) > MIN_ALPHA)
        quads = _map_quads(level, level.joined)
        row, column = np.nonzero(candidates & (quads >= 0))
        if self._mesh is None or len(row) == 0:  # The discs of a point cloud have no silhouette of their own.
            return quads >= 0
        quad = quads[row, column]
        points = level.texel_size * (np.column_stack([column, row]) + 0.5 - 0.5 * np.array(level.atlas.size, np.float64))
        normals = level.quads.frames[quad, 2]
        origins = compute_placement(level).to_world(points, quad) - MAX_HEIGHT * level.error * normals
        continuation = np.zeros(candidates.shape, bool)
        continuation[row, column] = self._cast_rays(origins, normals, 2.0 * MAX_HEIGHT * level.error)
        return continuation

    def find_uncovered(self, level: Level, alphas: list[np.ndarray]) -> np.ndarray:
        """Return the quad (H, W) int32 with a chart of each texel that is not to be trusted, because the chart lies there beyond the
        surface; -1 for all others.

        Charts are cut by their triangles alone, and what they show must reach these everywhere.
        """
        quads = _map_quads(level, np.array([chart is not None for chart in level.charts], bool))
        opaque = np.min(alphas, axis=0) >= 1.0 - MIN_ALPHA
        is_missed = np.zeros(quads.shape, bool)
        for quad in np.unique(quads[(quads >= 0) & ~opaque]):
            row, column = np.nonzero((quads == quad) & ~opaque)
            points = level.texel_size * (np.column_stack([column, row]) + 0.5 - 0.5 * np.array(level.atlas.size, np.float64))
            chart, normal = level.charts[quad], level.quads.frames[quad, 2]
            placement = compute_placement(level)
            flat = placement.to_atlas(chart.vertices[chart.triangles], np.full(len(chart.triangles), quad))
            height = interpolate_in_triangles(points, flat[..., :2], flat[..., 2:])
            origins = placement.to_world(points, np.full(len(points), quad)) + (height - MAX_HEIGHT * level.error) * normal
            directions = np.broadcast_to(normal, origins.shape)
            is_missed[row, column] = ~self._cast_rays(origins, directions, 2.0 * MAX_HEIGHT * level.error)
        is_near_missed = is_missed | (max_of_neighbors(is_missed.astype(np.float32), level.atlas.quad_map) > 0.0) & ~opaque
        return np.where(is_near_missed, quads, -1)

    def _cast_rays(self, origins: np.ndarray, directions: np.ndarray, distance: float) -> np.ndarray:
        """Return whether each ray meets the surface within `distance`.

        The tree's unit of length is the `distance` of the first call, because the tree stores single precision.
        """
        if self._bvh is None:
            self._center = self._mesh.vertices.mean(axis=0)
            self._unit = distance
            vertices = ((self._mesh.vertices - self._center) / distance).tolist()
            self._bvh = BVHTree.FromPolygons(vertices, self._mesh.triangles.tolist(), all_triangles=True)
        local = ((origins - self._center) / self._unit).tolist()
        rays = zip(local, directions.tolist(), strict=True)
        max_distance = distance / self._unit
        return np.array([self._bvh.ray_cast(Vector(origin), Vector(ray), max_distance)[0] is not None for origin, ray in rays], bool)


def _map_quads(level: Level, is_wanted: np.ndarray) -> np.ndarray:
    """Return the index (H, W) int32 of the quad to which each texel belongs; -1 for none, and for quads that `is_wanted` (Q,) bool
    excludes."""
    quads = level.atlas.quad_map
    return np.where(np.append(is_wanted, False)[quads], quads, -1)
