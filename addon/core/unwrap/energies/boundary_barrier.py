"""Barrier that keeps the boundary of a UV map from intersecting itself.

A map without flipped triangles and with a simple boundary is free of overlaps. Every boundary vertex is kept away from every boundary edge
that it does not belong to, by an energy that sets in at a small distance and is infinite at distance 0 (Smith, Schaefer: Bijective
parameterization with free boundaries, 2015). The energy of a boundary that intersects itself is infinite, so that no step ends there.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...arrays import TINY, concatenate_ranges
from ...geometry.proximity import sorted_unique
from ...geometry.transforms import cross
from ..cutting.boundaries import boundary_edges
from .stretch_energy import smallest_positive_root

STIFFNESS = 0.1  # Relative to the squared activation distance, which is close to the stretch energy of a triangle.
MAX_EDGES_FOR_ALL_PAIRS = 100  # Up to this number all pairs of edges are tested.
MAX_ANGLE_ERROR = 1e-6  # Radians, of the sum of angles around a vertex.
MAX_SAMPLES_PER_EDGE = 16  # On average, to find what is close to long edges.


class BoundaryBarrier:
    """Barrier energy of uv (V, 2) for boundary edges (B, 2) int, each starting at a different vertex.

    activation_distance: distance in the UV map at which the energy sets in.
    """

    def __init__(self, boundary: np.ndarray, activation_distance: float) -> None:
        self._boundary, self._activation_distance = boundary, activation_distance
        self._cache: tuple[np.ndarray, np.ndarray, _Contacts] | None = None  # The same uv is evaluated several times in a row.

    def value(self, uv: np.ndarray) -> float:
        """Return the energy; infinite where the boundary intersects itself."""
        pairs, contacts = self._find_contacts(uv)
        if _any_intersect(uv[self._boundary[pairs]]):
            return np.inf
        ratio = self._activation_distance / contacts.distances
        return float(STIFFNESS * self._activation_distance**2 * ((ratio - 1.0) ** 2).sum())

    def gradients(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the vertices (P, 3) of the contacts and the gradients (P, 6) by their x and y in turn."""
        _, contacts = self._find_contacts(uv)
        ratio = self._activation_distance / contacts.distances
        derivative = -2.0 * STIFFNESS * self._activation_distance * (ratio - 1.0) * ratio**2
        return contacts.vertices, derivative[:, None] * contacts.distance_gradients

    def hessians(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the same vertices (P, 3) and the Hessians (P, 6, 6), positive semidefinite (Gauss-Newton)."""
        _, contacts = self._find_contacts(uv)
        ratio, gradients = self._activation_distance / contacts.distances, contacts.distance_gradients
        second_derivative = 2.0 * STIFFNESS * (3.0 * ratio - 2.0) * ratio**3
        return contacts.vertices, second_derivative[:, None, None] * gradients[:, :, None] * gradients[:, None, :]

    def max_step(self, uv: np.ndarray, displacement: np.ndarray) -> float:
        """Return the multiple of `displacement` (V, 2) at which the first vertex in contact reaches the line of its edge, or infinity."""
        _, contacts = self._find_contacts(uv)
        is_beside_edge = (contacts.t > 0.0) & (contacts.t < 1.0)
        vertices = contacts.vertices[is_beside_edge]
        positions, changes = uv[vertices], displacement[vertices]
        (first, second), (first_change, second_change) = (
            (corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) for corners in (positions, changes)
        )
        area = cross(first, second)
        sign = np.sign(area)
        return smallest_positive_root(
            sign * cross(first_change, second_change),
            sign * (cross(first, second_change) + cross(first_change, second)),
            np.abs(area),
        )

    def _find_contacts(self, uv: np.ndarray) -> tuple[np.ndarray, "_Contacts"]:
        """Return pairs (Q, 2) of edges that may be in contact, and the contacts among them."""
        if self._cache is None or self._cache[0] is not uv:
            pairs = _close_edge_pairs(uv, self._boundary, self._activation_distance)
            self._cache = uv, pairs, self._compute_contacts(uv, pairs)
        return self._cache[1:]

    def _compute_contacts(self, uv: np.ndarray, pairs: np.ndarray) -> "_Contacts":
        """Return the contacts within the activation distance among `pairs` (Q, 2) of edges."""
        first, second = self._boundary[pairs].transpose(1, 0, 2)
        vertices = np.concatenate([np.column_stack([first[:, 0], second]), np.column_stack([second[:, 0], first])])
        point, start, end = uv[vertices].transpose(1, 0, 2)
        edge = end - start
        t = np.einsum("pi,pi->p", point - start, edge) / np.maximum(np.einsum("pi,pi->p", edge, edge), TINY)
        t = np.clip(t, 0.0, 1.0)
        offsets = point - start - t[:, None] * edge
        distances = np.maximum(np.hypot(*offsets.T), 1e-12 * self._activation_distance)
        is_active = distances < self._activation_distance
        return _Contacts(vertices[is_active], t[is_active], offsets[is_active], distances[is_active])


@dataclass(frozen=True)
class _Contacts:
    """P vertices close to edges.

    vertices (P, 3): the vertex and the ends of the edge. t (P,): parameter of the closest point on the edge. offsets (P, 2): from the
    closest point to the vertex. distances (P,): their lengths.
    """

    vertices: np.ndarray
    t: np.ndarray
    offsets: np.ndarray
    distances: np.ndarray

    @property
    def distance_gradients(self) -> np.ndarray:
        """Gradients (P, 6) of the distances by x and y of the three vertices in turn."""
        normals, t = self.offsets / self.distances[:, None], self.t[:, None]
        return np.concatenate([normals, (t - 1.0) * normals, -t * normals], axis=1)


def self_intersects(uv: np.ndarray, boundary: np.ndarray) -> bool:
    """Return whether two edges of a `boundary` (B, 2) that share no vertex intersect in uv (V, 2)."""
    return _any_intersect(uv[boundary[_close_edge_pairs(uv, boundary, 0.0)]])


def overlaps_itself(uv: np.ndarray, triangles: np.ndarray) -> bool:
    """Return whether a map uv (V, 2) without flipped `triangles` (T, 3) overlaps itself: its boundary intersects itself, or the triangles
    around one of its vertices fill more than a circle."""
    corners = uv[triangles]
    following, previous = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    angles = np.arctan2(cross(following, previous), np.einsum("tkc,tkc->tk", following, previous))
    sums = np.bincount(triangles.ravel(), angles.ravel())
    return bool(sums.max() > 2.0 * np.pi + MAX_ANGLE_ERROR) or self_intersects(uv, boundary_edges(triangles))


def _close_edge_pairs(uv: np.ndarray, boundary: np.ndarray, max_distance: float) -> np.ndarray:
    """Return pairs (Q, 2) of edges that share no vertex, including all within `max_distance` of each other."""
    starts, ends = uv[boundary[:, 0]], uv[boundary[:, 1]]
    find_pairs = _pairs_by_boxes if len(boundary) <= MAX_EDGES_FOR_ALL_PAIRS else _pairs_by_samples
    pairs = find_pairs(starts, ends, max_distance)
    first, second = boundary[pairs].transpose(1, 0, 2)
    return pairs[(first[:, :, None] != second[:, None, :]).all(axis=(1, 2))]


def _pairs_by_boxes(starts: np.ndarray, ends: np.ndarray, max_distance: float) -> np.ndarray:
    """Return pairs (Q, 2) of segments from `starts` (B, 2) to `ends` whose bounding boxes are within `max_distance` of each other."""
    low, high = np.minimum(starts, ends) - max_distance, np.maximum(starts, ends)
    overlap = (low[:, None] <= high).all(axis=2)
    return np.stack(np.nonzero(np.triu(overlap & overlap.T, 1)), axis=1)


def _pairs_by_samples(starts: np.ndarray, ends: np.ndarray, max_distance: float) -> np.ndarray:
    """Return pairs (Q, 2) of segments from `starts` (B, 2) to `ends`, including all within `max_distance` of each other."""
    lengths = np.hypot(*(ends - starts).T)
    spacing = max(float(np.median(lengths)), float(lengths.sum()) / (MAX_SAMPLES_PER_EDGE * len(starts)), max_distance, TINY)
    counts = np.maximum(np.ceil(lengths / spacing).astype(int), 1)
    owner = np.repeat(np.arange(len(starts)), counts)
    t = (concatenate_ranges(0, counts) + 0.5) / counts[owner]
    samples = starts[owner] + t[:, None] * (ends - starts)[owner]
    pairs = np.sort(owner[cKDTree(samples).query_pairs(spacing + max_distance, output_type="ndarray")], axis=1)
    keys, _ = sorted_unique(pairs[:, 0].astype(np.int64) * len(starts) + pairs[:, 1])
    return np.stack(np.divmod(keys, len(starts)), axis=1)


def _any_intersect(segments: np.ndarray) -> bool:
    """Return whether the segments of any pair intersect, (Q, 2, 2, 2): pair, segment, end, axis."""
    (a, b), (c, d) = (segments[:, index].transpose(1, 0, 2) for index in (0, 1))
    is_separated = (_orientation(a, b, c) * _orientation(a, b, d) > 0.0) | (_orientation(c, d, a) * _orientation(c, d, b) > 0.0)
    boxes_overlap = ((np.minimum(a, b) <= np.maximum(c, d)) & (np.minimum(c, d) <= np.maximum(a, b))).all(axis=1)
    return bool((~is_separated & boxes_overlap).any())


def _orientation(start: np.ndarray, end: np.ndarray, point: np.ndarray) -> np.ndarray:
    return cross(end - start, point - start)
