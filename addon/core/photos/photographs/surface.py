"""The surface that photographs show, with the normals by which they see it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...errors import GeometryError
from ...geometry.edges import Edges, find_edges
from ...geometry.mesh import TriangleMesh, check_points, face_areas_and_normals, vertex_normals
from ...geometry.transforms import normalize

MIN_SMOOTH_COSINE = 0.7  # A triangle has its own normal at corners where it bends away from that of the vertex by a larger angle.


@dataclass(frozen=True)
class Surface:
    """A mesh, moved to the origin, where float32 is exact enough.

    Attributes:
        mesh: relative to the origin.
        origin: (3,) in the coordinates of the given mesh.
        areas: (T,) of the triangles.
    """

    mesh: TriangleMesh
    origin: np.ndarray
    areas: np.ndarray

    @classmethod
    def around_origin(cls, mesh: TriangleMesh) -> "Surface":
        """Move `mesh` to the origin. Raises GeometryError if it is not finite."""
        check_points(mesh.vertices, "mesh")
        origin = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        return cls(TriangleMesh(mesh.vertices - origin, mesh.triangles), origin, face_areas_and_normals(mesh.corners)[0])

    @cached_property
    def normals(self) -> np.ndarray:
        """(V, 3) unit normals of the vertices."""
        return vertex_normals(self.mesh.vertices, self.mesh.triangles)

    @cached_property
    def corner_normals(self) -> np.ndarray:
        """(T, 3, 3) unit normals of the corners of triangles: those of the vertices, or of the triangle where it bends away from them, so
        that the faces of a box do not look rounded."""
        _, face_normals = face_areas_and_normals(self.mesh.corners)
        result = self.normals[self.mesh.triangles]
        is_sharp = np.einsum("tic,tc->ti", result, face_normals) < MIN_SMOOTH_COSINE
        return np.where(is_sharp[..., None], face_normals[:, None], result)

    @cached_property
    def edges(self) -> Edges:
        """The edges of the mesh."""
        return find_edges(self.mesh.triangles, len(self.mesh.vertices))

    def check_areas(self) -> None:
        """Raise GeometryError if no triangle has an area."""
        if not self.areas.any():
            raise GeometryError("The faces of the mesh have no area; scale it up.")

    def locate(self, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the point (T, 3) with the same `barycentric` coordinates (3,) in each triangle, and its unit normal (T, 3)."""
        points, normals = (np.einsum("i,tic->tc", barycentric, values) for values in (self.mesh.corners, self.corner_normals))
        return points, normalize(normals)
