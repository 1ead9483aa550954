"""What is clustered: triangles, or the squares that stand for the discs of a point cloud, as one kind of thing."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..mesh import PointCloud, TriangleMesh, face_areas_and_normals
from ..spatial import neighbour_pairs

NEIGHBOURS = 50  # n of section 4.3.1
TRIANGLE_SPREAD = 1.0 / 4.0  # covariance of a triangle's area over the mean covariance of its corners
SQUARE_SPREAD = 1.0 / 3.0  # the same for a square


@dataclass(frozen=True)
class Primitives:
    """P flat convex pieces with C corners each, in world space.

    points (V, 3) float64; corners (P, C) int32 into points; areas (P,); normals (P, 3) unit.
    """

    points: np.ndarray
    corners: np.ndarray
    areas: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.corners)

    @cached_property
    def positions(self) -> np.ndarray:
        """(P, C, 3) corner positions."""
        return self.points[self.corners]

    @cached_property
    def covariances(self) -> np.ndarray:
        """(P, 3, 3) covariance of the surface of each piece about its centroid."""
        spread = TRIANGLE_SPREAD if self.corners.shape[1] == 3 else SQUARE_SPREAD
        centred = self.positions - self.positions.mean(axis=1, keepdims=True)
        return spread * np.einsum("pci,pcj->pij", centred, centred) / self.corners.shape[1]

    @cached_property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """The proximity graph, pairs (E, 2) int32 and distances (E,), see `spatial.neighbour_pairs`; the same for every error."""
        return neighbour_pairs(self.positions, NEIGHBOURS)

    def subset(self, index: np.ndarray) -> "Primitives":
        """The pieces `index` (K,) alone, numbered in that order; all points stay."""
        return Primitives(self.points, self.corners[index], self.areas[index], self.normals[index])


def from_mesh(mesh: TriangleMesh) -> Primitives:
    """The triangles of a mesh without zero-area ones (see `mesh.without_zero_area`)."""
    areas, normals = face_areas_and_normals(mesh.corners)
    return Primitives(mesh.vertices, mesh.triangles, areas, normals)


def from_points(cloud: PointCloud) -> Primitives:
    """Each disc as the square of its radius in its tangent plane, so that bounds hold for the whole splat."""
    helper = np.eye(3)[np.abs(cloud.normals).argmin(axis=1)]
    u = np.cross(helper, cloud.normals)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(cloud.normals, u)
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    arms = signs[:, 0, None] * u[:, None] + signs[:, 1, None] * v[:, None]
    corners = cloud.points[:, None] + cloud.radii[:, None, None] * arms
    index = np.arange(4 * len(cloud.points), dtype=np.int32).reshape(-1, 4)
    return Primitives(corners.reshape(-1, 3), index, 4.0 * cloud.radii**2, cloud.normals)
