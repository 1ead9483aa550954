"""How much the removals of vertices are seen (section IV.B of the paper)."""

import numpy as np

from ...arrays import TINY
from .topology import BOUNDARY, Topology


class PerceptualValues:
    """Perceptual values of vertices when they are removed: their distances to the mean planes of their neighbors, with what they have
    absorbed, the cumulated sum (Figure 12)."""

    def __init__(self, vertices: np.ndarray) -> None:
        """vertices: (V, 3)."""
        self._positions = np.ascontiguousarray(vertices.T)
        self._absorbed = np.zeros(len(vertices))

    def append(self, vertices: np.ndarray) -> None:
        """Append copies of `vertices` (N,)."""
        self._positions = np.concatenate([self._positions, self._positions[:, vertices]], axis=1)
        self._absorbed = np.concatenate([self._absorbed, self._absorbed[vertices]])

    def estimate(self, topology: Topology, vertices: np.ndarray) -> np.ndarray:
        """Return what the removal of `vertices` (N,) would be seen as, whatever they collapse onto: cumulated distances to
        mean planes. On a curve, the last one is at least the distance to the edge between the neighbors there, by which the
        boundary or the textures on both sides move."""
        distances = measure_plane_distances(self._positions, topology, vertices)
        rows = np.flatnonzero(topology.is_on_curve[vertices])
        distances[rows] = np.maximum(distances[rows], _measure_curve_distances(self._positions, topology, vertices[rows]))
        return self._absorbed[vertices] + distances

    def record(self, topology: Topology, removed: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the values (N,) of `removed` vertices (N,), whose stimuli the `kept` (N,) absorb."""
        distances = self._absorbed[removed] + measure_plane_distances(self._positions, topology, removed)
        np.add.at(self._absorbed, kept, distances)
        return distances


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
