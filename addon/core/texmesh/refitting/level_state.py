"""A level while it is refitted: arrays that change, its fine mesh, and the samples of the fine mesh that it is fitted to."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ...geometry.edges import Edges, find_edges
from ...geometry.mesh import face_areas_and_normals
from ..textured_mesh import TexturedMesh
from .correspondence import UNTEXTURED, Correspondence, SurfaceSamples, find_correspondence


@dataclass(frozen=True)
class LevelState:
    """A level, its samples and the points of the level that correspond to them.

    Arrays are never changed in place.

    Attributes:
        mesh: the level; its `sources` follow its wedges.
        islands: (T,) int32 of the fine mesh.
        samples: of the fine mesh, N of them.
        found: the points of the level with their texture coordinates.
        normal_weight: how much more a deviation along the normal of the level counts than one along the surface.
    """

    mesh: TexturedMesh
    islands: np.ndarray
    samples: SurfaceSamples
    found: Correspondence
    normal_weight: float

    @cached_property
    def corners(self) -> np.ndarray:
        """(T, 3, 3) float64 positions of the corners."""
        return self.mesh.vertices[self.mesh.triangles]

    @cached_property
    def areas_and_normals(self) -> tuple[np.ndarray, np.ndarray]:
        """(T,) areas and (T, 3) unit normals of the triangles."""
        return face_areas_and_normals(self.corners)

    @cached_property
    def edges(self) -> Edges:
        """The edges of the level."""
        return find_edges(self.mesh.triangles, len(self.mesh.vertices))

    @cached_property
    def residuals(self) -> np.ndarray:
        """(N, 3) vectors from the samples to the corresponding points of the level, column by column in memory."""
        corners = [corner.take(self.found.triangles) for corner in self.mesh.triangles.T.copy()]
        residuals = np.negative(self.samples.positions.T, order="C")
        for values, column in zip(residuals, self.mesh.vertices.T.copy(), strict=True):
            for weights, corner in zip(self.found.barycentric.T, corners, strict=True):
                values += weights * column.take(corner)
        return residuals.T

    @cached_property
    def costs(self) -> np.ndarray:
        """(N,) cost of each sample: weighted squared distance times area."""
        _, normals = self.areas_and_normals
        squares, along = np.zeros(len(self.samples.weights)), np.zeros(len(self.samples.weights))
        for values, column in zip(self.residuals.T, normals.T.copy(), strict=True):
            squares += values * values
            along += values * column.take(self.found.triangles)
        return self.samples.weights * (squares + (self.normal_weight - 1.0) * along**2)

    def move(self, vertices: np.ndarray, uvs: np.ndarray | None = None) -> "LevelState":
        """Return the level with other `vertices` (V, 3) and, if given, other `uvs` (W, 2), whose corresponding points are found again."""
        if uvs is None:
            return replace(self, mesh=replace(self.mesh, vertices=vertices))
        mesh = replace(self.mesh, vertices=vertices, uvs=uvs)
        return attach(mesh, self.islands, self.samples, self.normal_weight, self.found.triangles)

    def replace_triangles(self, mesh: TexturedMesh, groups: np.ndarray) -> "LevelState":
        """Return the level with another `mesh`, in which the triangles of each row of `groups` (K, C) cover together what they covered."""
        group_of = np.full(len(self.islands), -1)
        group_of[groups] = np.arange(len(groups))[:, None]
        sample_groups = group_of[self.found.triangles]
        moved = np.flatnonzero(sample_groups >= 0)
        rows = groups.ravel()
        found = find_correspondence(
            self.samples.take(moved, np.where(self.found.is_spatial[moved], UNTEXTURED, sample_groups[moved])),
            mesh.vertices[mesh.triangles[rows]],
            mesh.corner_uvs[rows],
            group_of[rows],
        )
        triangles, barycentric = self.found.triangles.copy(), self.found.barycentric.copy("F")
        is_spatial = self.found.is_spatial.copy()
        triangles[moved], barycentric[moved], is_spatial[moved] = rows[found.triangles], found.barycentric, found.is_spatial
        return replace(self, mesh=mesh, found=Correspondence(triangles, barycentric, self.found.is_covered, is_spatial))


def attach(
    mesh: TexturedMesh, islands: np.ndarray, samples: SurfaceSamples, normal_weight: float, guess: np.ndarray | None = None
) -> LevelState:
    """Return the state of the level `mesh` with triangles in `islands` (T,), with corresponding points for all `samples`. guess: see
    `find_correspondence`."""
    found = find_correspondence(samples, mesh.vertices[mesh.triangles], mesh.corner_uvs, islands, guess)
    return LevelState(mesh, islands, samples, found, normal_weight)


def sum_by(indices: np.ndarray, count: int) -> csr_array:
    """Return the matrix (count, K) that sums rows by their `indices` (K,)."""
    flat = indices.ravel()
    return csr_array((np.ones(len(flat)), (flat, np.arange(len(flat)))), shape=(count, len(flat)))
