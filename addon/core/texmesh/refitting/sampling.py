"""Points on a textured mesh, uniform by area, with their texture coordinates and UV islands."""

from dataclasses import dataclass

import numpy as np

from ...arrays import concatenate_ranges
from ...geometry.mesh import face_areas_and_normals
from ..textured_mesh import TexturedMesh


@dataclass(frozen=True)
class SurfaceSamples:
    """Points on the surface of a textured mesh.

    Attributes:
        triangles: (N,) int64 of the mesh. barycentric: (N, 3) float64.
        positions: (N, 3) float64, in the space of the mesh. uvs: (N, 2) float64.
        islands: (N,) int32, the UV islands of `find_islands`.
        weights: (N,) float64, the areas that the samples stand for.
    """

    triangles: np.ndarray
    barycentric: np.ndarray
    positions: np.ndarray
    uvs: np.ndarray
    islands: np.ndarray
    weights: np.ndarray

    def take(self, rows: np.ndarray, islands: np.ndarray) -> "SurfaceSamples":
        """Return the samples `rows` (K,), with other `islands` (K,)."""
        values = (self.triangles, self.barycentric, self.positions, self.uvs)
        return SurfaceSamples(*(value[rows] for value in values), islands, self.weights[rows])


def sample_surface(
    mesh: TexturedMesh, islands: np.ndarray, count: int, generator: np.random.Generator, triangle_fraction: float = 0.0
) -> SurfaceSamples:
    """Return about `count` points on the mesh, uniform by 3D area; equal areas get equal numbers of points, rounded up or down.

    islands: (T,) from `find_islands`. triangle_fraction: of the points, those that are divided evenly among the triangles, however small.
    Then the points stand for different areas.
    """
    areas, _ = face_areas_and_normals(mesh.vertices[mesh.triangles])
    expected = count * ((1.0 - triangle_fraction) * areas / areas.sum() + triangle_fraction / len(areas))
    ends = np.cumsum(expected) + generator.uniform()
    counts = np.diff(np.floor(ends), prepend=0.0).astype(np.int64)
    triangles = np.repeat(np.arange(len(areas)), counts)
    order = concatenate_ranges(0, counts)
    barycentric = _spread_points(order, counts[triangles], generator)
    if triangle_fraction > 0.0:
        weights = (areas / np.where(expected < 1.0, expected, np.maximum(counts, 1)))[triangles]
    else:
        weights = np.full(len(triangles), areas.sum() / max(len(triangles), 1))
    return SurfaceSamples(
        triangles,
        barycentric,
        np.einsum("ni,nic->nc", barycentric, mesh.vertices[mesh.triangles[triangles]]),
        np.einsum("ni,nic->nc", barycentric, mesh.uvs[mesh.wedge_triangles[triangles]]),
        islands[triangles],
        weights,
    )


def _spread_points(order: np.ndarray, counts: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return barycentric coordinates (N, 3) of the points number `order` (N,) of `counts` (N,) in triangles, spread evenly: the first
    coordinate of a square is stratified, the second a van der Corput sequence with a random shift per point of the first triangle."""
    first = (order + generator.uniform(size=len(order))) / np.maximum(counts, 1)
    second = np.mod(_reverse_bits(order) + generator.uniform(size=len(order)) / np.maximum(counts, 1), 1.0)
    root = np.sqrt(first)
    return np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)


def _reverse_bits(numbers: np.ndarray) -> np.ndarray:
    """Return the van der Corput sequence (N,) in base 2 at `numbers` (N,)."""
    result, fraction, rest = np.zeros(len(numbers)), 0.5, numbers.copy()
    while rest.any():
        result += fraction * (rest & 1)
        rest >>= 1
        fraction *= 0.5
    return result
