"""Questions about the surface of the fine mesh: the nearest point, and the point with given texture coordinates."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.distance import TriangleTree
from ...geometry.mesh import face_areas_and_normals
from ..textured_mesh import TexturedMesh
from .correspondence import Correspondence, find_correspondence
from .sampling import SurfaceSamples


@dataclass(frozen=True)
class FineSurface:
    """The fine mesh that levels are measured from, and the UV islands (T,) of its triangles."""

    mesh: TexturedMesh
    islands: np.ndarray

    def measure_distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distances (N,) of `points` (N, 3) from the surface."""
        return self.find_closest(points)[0]

    def find_closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (N,) of `points` (N, 3) from the surface, and the nearest triangles (N,)."""
        return self._tree.find_closest(points)

    @cached_property
    def _tree(self) -> TriangleTree:
        return TriangleTree(self.mesh.vertices[self.mesh.triangles])

    def find_positions(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the points (N, 3) of the surface with texture coordinates `uvs` (N, 2) in `islands` (N,); of several the nearest to
        `points` (N, 3)."""
        found = self.find_points(points, uvs, islands)
        return np.einsum("ni,nic->nc", found.barycentric, self.mesh.vertices[self.mesh.triangles[found.triangles]])

    def find_normals(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the unit normals (N, 3) of the surface at the same points."""
        triangles = self.find_points(points, uvs, islands).triangles
        return face_areas_and_normals(self.mesh.vertices[self.mesh.triangles[triangles]])[1]

    def find_points(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> Correspondence:
        """Return these points of the surface by triangle; where an island does not have the coordinates, the ones nearest to them there."""
        corners = self.mesh.vertices[self.mesh.triangles]
        blank = np.zeros(len(points))
        samples = SurfaceSamples(blank.astype(np.int64), np.zeros((len(points), 3)), points, uvs, islands, blank)
        return find_correspondence(samples, corners, self.mesh.corner_uvs, self.islands)
