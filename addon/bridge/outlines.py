"""Where the surface that a quad shows goes on past what is drawn on it, so that its outline may grow without making a trunk thicker."""

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..core.billboards.cloud import Level
from ..core.images import EMPTY, largest_beside
from .meshes import Source
from .slots import slots_of

REACH = 2.0  # errors above and below the plane of a quad in which its surface is looked for


class Continuations:
    """Looks for the surface of `source` beside the outlines of its quads."""

    def __init__(self, source: Source) -> None:
        self._mesh = source.mesh
        self._tree: BVHTree | None = None

    def texels(self, level: Level, alphas: list[np.ndarray]) -> np.ndarray:
        """Texels (H, W) bool of joined quads, on the outline of one of `alphas` (H, W) or beside it, over which the surface goes on."""
        candidates = np.zeros(alphas[0].shape, bool)
        for alpha in alphas:
            candidates |= (alpha < 1.0 - EMPTY) & (largest_beside(alpha) > EMPTY)
        quads = _joined_quads(level)
        row, column = np.nonzero(candidates & (quads >= 0))
        if self._mesh is None or len(row) == 0:  # the discs of a point cloud have no outline of their own
            return quads >= 0
        quad = quads[row, column]
        flat = level.texel * (np.column_stack([column, row]) + 0.5 - 0.5 * np.array(level.atlas.size, np.float64))
        normals = level.quads.frames[quad, 2]
        start = slots_of(level).restore(flat, quad) - REACH * level.error * normals
        goes_on = np.zeros(candidates.shape, bool)
        goes_on[row, column] = self._hits(start, normals, 2.0 * REACH * level.error)
        return goes_on

    def _hits(self, starts: np.ndarray, directions: np.ndarray, distance: float) -> np.ndarray:
        """Whether each ray meets the surface within `distance`. In lengths of that distance, for single precision."""
        if self._tree is None:
            self._middle = self._mesh.vertices.mean(axis=0)
            self._unit = distance
            points = ((self._mesh.vertices - self._middle) / distance).tolist()
            self._tree = BVHTree.FromPolygons(points, self._mesh.triangles.tolist(), all_triangles=True)
        local = ((starts - self._middle) / self._unit).tolist()
        rays = zip(local, directions.tolist(), strict=True)
        reach = distance / self._unit
        return np.array([self._tree.ray_cast(Vector(start), Vector(along), reach)[0] is not None for start, along in rays], bool)


def _joined_quads(level: Level) -> np.ndarray:
    """The joined quad (H, W) int32 that each texel of the atlas belongs to, half of the gutter with it; -1 for none."""
    width, height = level.atlas.size
    quads = np.full((height, width), -1, np.int32)
    room = level.atlas.gutter // 2
    for quad in np.flatnonzero(level.joined):
        x, y, wide, tall = level.atlas.rectangles[quad]
        quads[y - room : y + tall + room, x - room : x + wide + room] = quad
    return quads
