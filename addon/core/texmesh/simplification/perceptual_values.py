"""How much the removal of a vertex is seen (section IV.B of the paper)."""

import numpy as np

from ...arrays import TINY
from ...geometry.mesh import scaled_normals
from ..textured_mesh import TexturedMesh
from .settings import CENTER, PLANE, QUADRIC, SKELETON
from .topology import BOUNDARY, Topology

CROSS_SECTIONS = 32
PLANE_TERMS = 10  # of the upper triangle of a symmetric 4 x 4 matrix


class PerceptualValues:
    """Perceptual values of vertices when they are removed, with what they have absorbed: the cumulated sum (Figure 12)."""

    def __init__(self, mesh: TexturedMesh, measure: str) -> None:
        """measure: one of `settings.PERCEPTUAL_VALUES`."""
        self._positions = np.ascontiguousarray(mesh.vertices.T)
        self._measure = measure
        self._absorbed, self._absorbed_distances = np.zeros(len(mesh.vertices)), np.zeros(len(mesh.vertices))
        if measure in (CENTER, SKELETON):
            self._axis_distances = _find_axis_distances(mesh.vertices, CROSS_SECTIONS if measure == SKELETON else 1)
        if measure == QUADRIC:
            self._quadrics = _build_plane_quadrics(mesh)

    def estimate(self, topology: Topology, vertices: np.ndarray) -> np.ndarray:
        """Return what the removal of `vertices` (N,) would be seen as, whatever they collapse onto and whatever the measure: cumulated
        distances to mean planes. On a curve, the last one is at least the distance to the edge between the neighbors there, by which the
        boundary or the textures on both sides move."""
        distances = measure_plane_distances(self._positions, topology, vertices)
        rows = np.flatnonzero(topology.is_on_curve[vertices])
        distances[rows] = np.maximum(distances[rows], _measure_curve_distances(self._positions, topology, vertices[rows]))
        return self._absorbed_distances[vertices] + distances

    def record(self, topology: Topology, removed: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the values (N,) of `removed` vertices (N,), whose stimuli the `kept` (N,) absorb."""
        distances = self._absorbed_distances[removed] + measure_plane_distances(self._positions, topology, removed)
        np.add.at(self._absorbed_distances, kept, distances)
        if self._measure == PLANE:
            return distances
        if self._measure == QUADRIC:
            np.add.at(self._quadrics, kept, self._quadrics[removed])
            return _evaluate_planes(self._quadrics[removed], self._positions[:, kept])
        displacements = np.linalg.norm(self._positions[:, removed] - self._positions[:, kept], axis=0)
        values = self._absorbed[removed] + displacements / np.maximum(self._axis_distances[kept], TINY)
        np.add.at(self._absorbed, kept, values)
        return values


def measure_plane_distances(positions: np.ndarray, topology: Topology, vertices: np.ndarray) -> np.ndarray:
    """Return the distances (N,) of `vertices` (N,) to the mean planes of their neighbors, in the unit of `positions` (3, V).

    The plane goes through the mean of the neighbors, perpendicular to the vector area of the polygon that they form.
    """
    owners, corners = topology.find_corners(vertices)
    preceding = topology.previous(corners)
    following = topology.ends[corners]
    count = len(vertices)
    neighbors = positions.take(following, axis=1)
    others = positions.take(topology.starts[preceding], axis=1)
    is_last = topology.twins[preceding] == BOUNDARY
    numbers = np.bincount(owners, minlength=count) + np.bincount(owners[is_last], minlength=count)
    center = np.empty((3, count))
    for axis in range(3):
        sums = np.bincount(owners, neighbors[axis], count) + np.bincount(owners[is_last], others[axis, is_last], count)
        center[axis] = sums / np.maximum(numbers, 1)
    first, second = neighbors - center[:, owners], others - center[:, owners]
    normal = np.empty((3, count))
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        normal[axis] = np.bincount(owners, first[i] * second[j] - first[j] * second[i], count)
    offset = positions[:, vertices] - center
    lengths = np.sqrt((normal**2).sum(axis=0))
    return np.where(lengths > 0.0, np.abs((offset * normal).sum(axis=0)) / np.maximum(lengths, TINY), np.sqrt((offset**2).sum(axis=0)))


def _measure_curve_distances(positions: np.ndarray, topology: Topology, vertices: np.ndarray) -> np.ndarray:
    """Return the distances (N,) of `vertices` (N,) to the segments between their neighbors on curves, in the unit of `positions` (3, V)."""
    first, second = topology.curve_neighbors[:, vertices]
    start = positions[:, first]
    direction, offset = positions[:, second] - start, positions[:, vertices] - start
    fraction = np.clip((direction * offset).sum(axis=0) / np.maximum((direction**2).sum(axis=0), TINY), 0.0, 1.0)
    return np.sqrt(((offset - fraction * direction) ** 2).sum(axis=0))


def _find_axis_distances(vertices: np.ndarray, sections: int) -> np.ndarray:
    """Return the distances (V,) of vertices to the centers of cross sections along the longest principal axis."""
    centered = vertices - vertices.mean(axis=0)
    along = centered @ np.linalg.svd(centered.T @ centered)[0][:, 0]
    low, extent = along.min(), max(float(np.ptp(along)), TINY)
    section = np.minimum((sections * ((along - low) / extent)).astype(int), sections - 1)
    counts = np.bincount(section, minlength=sections)
    used = np.flatnonzero(counts)
    midpoints = low + (used + 0.5) * extent / sections
    centers = np.stack([np.bincount(section, vertices[:, axis], sections)[used] / counts[used] for axis in range(3)])
    nearest = np.stack([np.interp(along, midpoints, center) for center in centers], axis=1)
    return np.linalg.norm(vertices - nearest, axis=1)


def _build_plane_quadrics(mesh: TexturedMesh) -> np.ndarray:
    """Return the sums (V, 10) of the squared distances to the planes of each vertex's triangles, weighted by area."""
    corners = mesh.vertices[mesh.triangles]
    normals = scaled_normals(corners)
    lengths = np.linalg.norm(normals, axis=1)
    units = normals / np.maximum(lengths, TINY)[:, None]
    planes = np.concatenate([units, -np.einsum("ij,ij->i", units, corners[:, 0])[:, None]], axis=1)
    rows, columns = np.triu_indices(4)
    terms = planes[:, rows] * planes[:, columns] * lengths[:, None]
    quadrics = np.empty((len(mesh.vertices), PLANE_TERMS))
    for term in range(PLANE_TERMS):
        quadrics[:, term] = np.bincount(mesh.triangles.reshape(-1), np.repeat(terms[:, term], 3), len(mesh.vertices))
    return quadrics


def _evaluate_planes(quadrics: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the root mean squared distances (N,) of `positions` (3, N) to the planes of `quadrics` (N, 10)."""
    rows, columns = np.triu_indices(4)
    points = np.concatenate([positions, np.ones((1, positions.shape[1]))])
    factors = np.where(rows == columns, 1.0, 2.0)[:, None]
    squares = (quadrics.T * factors * points[rows] * points[columns]).sum(axis=0)
    is_diagonal = np.flatnonzero((rows == columns) & (rows < 3))
    return np.sqrt(np.maximum(squares, 0.0) / np.maximum(quadrics[:, is_diagonal].sum(axis=1), TINY))
