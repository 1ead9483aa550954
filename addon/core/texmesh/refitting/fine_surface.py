"""Questions about the surface of the fine mesh: the nearest point, and the point with given texture coordinates."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.distance import TriangleTree
from ...geometry.mesh import face_areas_and_normals
from ..textured_mesh import TexturedMesh
from .correspondence import Correspondence, find_in_triangles
from .sampling import SurfaceSamples
from .uv_triangles import UvTriangles


@dataclass(frozen=True)
class FineSurface:
    """The fine mesh that levels are measured from, and the UV islands (T,) of its triangles."""

    mesh: TexturedMesh
    islands: np.ndarray

    def find_closest(self, points: np.ndarray, enough: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (N,) of `points` (N, 3) from the surface, and the nearest triangles (N,). Distances up to `enough`, one or
        (N,), may be upper bounds, those from another triangle."""
        return self._tree.find_closest(points, enough)

    def measure_distances(self, points: np.ndarray, enough: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the distances alone, see `find_closest`."""
        return self.find_closest(points, enough)[0]

    @cached_property
    def corners(self) -> np.ndarray:
        """(T, 3, 3) float64 positions of the corners of the triangles."""
        return self.mesh.vertices[self.mesh.triangles]

    @cached_property
    def _tree(self) -> TriangleTree:
        return TriangleTree(self.corners)

    @cached_property
    def _uv_triangles(self) -> UvTriangles:
        return UvTriangles(self.mesh.corner_uvs, self.islands)

    def find_positions(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the points (N, 3) of the surface with texture coordinates `uvs` (N, 2) in `islands` (N,); of several the nearest to
        `points` (N, 3)."""
        found = self.find_points(points, uvs, islands)
        return np.einsum("ni,nic->nc", found.barycentric, self.corners[found.triangles])

    def find_normals(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the unit normals (N, 3) of the surface at the same points."""
        return face_areas_and_normals(self.corners[self.find_points(points, uvs, islands).triangles])[1]

    def find_points(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> Correspondence:
        """Return these points of the surface by triangle; where an island does not have the coordinates, the ones nearest to them there."""
        blank = np.zeros(len(points))
        samples = SurfaceSamples(blank.astype(np.int64), np.zeros((len(points), 3)), points, uvs, islands, blank)
        return find_in_triangles(samples, self.corners, self._uv_triangles)
