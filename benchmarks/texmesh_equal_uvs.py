"""Distances between surfaces for `bench_texmesh.py --only ordinary`: between points of equal texture coordinates, and between surfaces.

Where texture coordinates are used several times, as mirrored or repeated ones are, the nearest of all points with the same ones counts,
whatever their UV island. Of triangles without area in UV space, that is the nearest point in space if it has the same texture coordinates.
A point whose texture coordinates the other surface does not have gets the nearest point of the same material.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from farfield.addon.core.geometry.distance import TriangleTree, closest_barycentric
from farfield.addon.core.geometry.mesh import face_areas_and_normals
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.chunks import slices
from farfield.addon.core.texmesh.refitting.correspondence import SurfaceSamples, UvTriangles, sample_surface
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

CHUNK_SAMPLES = 1000  # Repeated texture coordinates have many candidates per sample.
MIN_UV_HEIGHT = 1e-6  # Of a triangle. Rounding to single precision moves texture coordinates by a tenth of it.
MAX_UV_DIFFERENCE = 1e-3  # Of equal ones in triangles without area: half a pixel of an image of 512 pixels.


@dataclass(frozen=True, eq=False)
class MeasuredSurface:
    """A surface with what measuring needs, made once. count: of the samples, uniform by area."""

    mesh: TexturedMesh
    count: int

    @cached_property
    def corners(self) -> np.ndarray:
        """(T, 3, 3) positions."""
        return self.mesh.vertices[self.mesh.triangles]

    @cached_property
    def area(self) -> float:
        """The area of the surface."""
        return float(face_areas_and_normals(self.corners)[0].sum())

    @cached_property
    def samples(self) -> SurfaceSamples:
        """Points on the surface; their islands are the materials."""
        return sample_surface(self.mesh, self.mesh.materials, self.count, np.random.default_rng(0))

    @cached_property
    def points(self) -> np.ndarray:
        """The samples and all vertices, (N, 3)."""
        return np.concatenate([self.samples.positions, np.unique(self.mesh.vertices, axis=0)])

    @cached_property
    def has_uv_area(self) -> np.ndarray:
        """(T,) bool, triangles on which texture coordinates tell points apart."""
        uvs = self.mesh.corner_uvs
        longest = np.linalg.norm(uvs - np.roll(uvs, 1, axis=1), axis=2).max(axis=1)
        return 2.0 * np.abs(signed_areas(uvs)) > MIN_UV_HEIGHT * longest

    @cached_property
    def tree(self) -> TriangleTree:
        """All triangles."""
        return TriangleTree(self.corners)

    @cached_property
    def material_trees(self) -> dict[int, TriangleTree]:
        """The triangles of each material."""
        return {int(number): TriangleTree(self.corners[self.mesh.materials == number]) for number in np.unique(self.mesh.materials)}

    @cached_property
    def uv_triangles(self) -> UvTriangles:
        """The triangles in UV space, told apart by material."""
        return UvTriangles(self.mesh.corner_uvs, self.mesh.materials)


@dataclass(frozen=True, eq=False)
class TextureDistances:
    """distances: (N,) between samples of a surface and points of another one with equal texture coordinates. is_lost: (N,) bool, samples
    whose texture coordinates the other one does not have."""

    distances: np.ndarray
    is_lost: np.ndarray


def measure_texture(source: MeasuredSurface, target: MeasuredSurface) -> TextureDistances:
    """Measure from the samples of `source` to `target`."""
    samples = source.samples
    distances = np.full(len(samples.uvs), np.inf)
    for chunk in slices(len(distances), CHUNK_SAMPLES):
        for row, triangle, barycentric in target.uv_triangles.find_containing(samples.uvs[chunk], samples.islands[chunk]):
            points = np.einsum("ni,nic->nc", barycentric, target.corners[triangle])
            found = row + chunk.start
            np.minimum.at(distances, found, np.linalg.norm(points - samples.positions[found], axis=1))
    np.minimum(distances, _measure_flat(samples, target), out=distances)
    is_lost = np.isinf(distances)
    for number in np.unique(samples.islands[is_lost]):
        rows = np.flatnonzero(is_lost & (samples.islands == number))
        tree = target.material_trees.get(int(number), target.tree)
        distances[rows] = tree.find_closest(samples.positions[rows])[0]
    return TextureDistances(distances, is_lost & source.has_uv_area[samples.triangles])


def _measure_flat(samples: SurfaceSamples, target: MeasuredSurface) -> np.ndarray:
    """Return the distances (N,) to the nearest points of triangles without UV area, infinite where they have other texture coordinates."""
    rows = np.flatnonzero(~target.has_uv_area)
    if not len(rows):
        return np.full(len(samples.uvs), np.inf)
    distances, nearest = TriangleTree(target.corners[rows]).find_closest(samples.positions)
    found = rows[nearest]
    barycentric = closest_barycentric(samples.positions, target.corners[found])
    uvs = np.einsum("ni,nic->nc", barycentric, target.mesh.corner_uvs[found])
    is_equal = (np.abs(uvs - samples.uvs).max(axis=1) <= MAX_UV_DIFFERENCE) & (target.mesh.materials[found] == samples.islands)
    return np.where(is_equal, distances, np.inf)


def measure_largest(first: MeasuredSurface, second: MeasuredSurface) -> float:
    """Return the largest distance of a sample or a vertex of one surface from the other one, of both ways."""
    return max(float(to.tree.find_closest(of.points)[0].max()) for of, to in ((first, second), (second, first)))
