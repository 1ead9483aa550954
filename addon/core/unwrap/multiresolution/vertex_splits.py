"""Undoes batches of collapses in a UV map (vertex splits) without flipping a triangle."""

import numpy as np

from ...arrays import TINY
from ...geometry.transforms import cross
from ..energies.rest_shapes import half_angle_tangents
from .halfedge_decimation import CollapseBatch
from .one_rings import OneRings

MIN_CLEARANCE = 0.05  # Positions closer to an edge than this fraction of the square root of the ring's area are moved away from it.
MAX_TRIES = 8  # To find a better position.
MAX_HALVINGS = 48


def split_vertices(uv: np.ndarray, batch: CollapseBatch, vertices: np.ndarray, bulge: float | None = None) -> np.ndarray:
    """Return the uv (V, 2) of the mesh before a batch of collapses, from the uv of the mesh after it, without flipping a triangle.

    Boundary vertices divide the boundary edge in proportion, next to its line where their triangles need space.

    Args:
        uv: (V, 2); entries of removed vertices are ignored.
        vertices: (V, 3) float64, on the surface.
        bulge: keeps the boundary away from itself: a vertex leaves the line outwards only if it belongs to a single triangle, and by at
            most this fraction of its length.
    """
    rings = OneRings(uv, batch.removed, batch.links, vertices, np.ones(len(vertices)))
    kept_uv = uv[batch.kept]
    sizes = np.sqrt(np.maximum(rings.sum_over_rings(rings.twice_areas(kept_uv)), 0.0))
    first_edges, last_edges = _open_ring_ends(rings.ring, rings.edges, len(vertices))
    open_rings = rings.ring[first_edges]
    is_at_kept = (rings.edges == batch.kept[rings.ring, None]).any(axis=1)
    # Fallback: from the kept vertex into the ring, as short as necessary.
    bases = kept_uv.copy()
    directions = sizes[:, None] * rings.sum_over_rings(np.where(is_at_kept[:, None], rings.inward_normals(), 0.0))
    positions, min_clearance = _mean_value_positions(rings, first_edges, last_edges), MIN_CLEARANCE * sizes
    if bulge is not None:
        kept_is_first = rings.edges[first_edges, 0] == batch.kept[open_rings]
        bases[open_rings], directions[open_rings] = _positions_near_chord(rings, first_edges, last_edges, kept_is_first, bulge)
        positions[open_rings], min_clearance[open_rings] = bases[open_rings] + directions[open_rings], -np.inf
    for _ in range(MAX_TRIES):
        clearance, closest = rings.clearance(positions)
        too_close = np.flatnonzero(clearance < min_clearance)
        if len(too_close) == 0:
            break
        distances = 1.5 * (min_clearance - clearance)[too_close, None]
        positions[too_close] += distances * rings.inward_normals()[closest[too_close]]
    uv = uv.copy()
    uv[batch.removed] = _move_inside(rings, positions, bases, directions)
    return uv


def _positions_near_chord(
    rings: OneRings, first_edges: np.ndarray, last_edges: np.ndarray, kept_is_first: np.ndarray, bulge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return start positions and directions (O, 2) of boundary vertices, close to the chord between their two boundary neighbors.

    They start at the kept neighbor, towards the other one where all between them is visible from there, else along the bisector of chord
    and the kept vertex's own edge. A vertex of a single triangle starts at the middle of the chord, outwards.

    Args:
        first_edges, last_edges: (O,) of the open rings.
        kept_is_first: (O,) bool, whether the kept vertex is at the first edge of the ring, or at the last.
    """
    first, last = rings.first[first_edges], rings.second[last_edges]
    kept, other = np.where(kept_is_first[:, None], first, last), np.where(kept_is_first[:, None], last, first)
    adjacent = np.where(kept_is_first[:, None], rings.second[first_edges], rings.first[last_edges])
    chord, edge = other - kept, adjacent - kept
    chord_lengths, edge_lengths = (np.maximum(np.hypot(*vectors.T), TINY)[:, None] for vectors in (chord, edge))
    is_visible = np.where(kept_is_first, 1.0, -1.0) * cross(edge, chord) > 0.0
    bisector = -np.minimum(chord_lengths, edge_lengths) * (chord / chord_lengths + edge / edge_lengths)
    directions = np.where(is_visible[:, None], 0.5 * chord, bisector)
    is_single = (first_edges == last_edges)[:, None]
    outward = bulge * chord_lengths * rings.inward_normals()[first_edges]
    return np.where(is_single, 0.5 * (kept + other), kept), np.where(is_single, outward, directions)


def _mean_value_positions(rings: OneRings, first_edges: np.ndarray, last_edges: np.ndarray) -> np.ndarray:
    """Return positions (N, 2) by the mean value coordinates of the vertices on the surface; on a boundary in proportion to lengths.

    first_edges, last_edges: (O,) of the open rings.
    """
    first, second = rings.corners[:, 1] - rings.corners[:, 0], rings.corners[:, 2] - rings.corners[:, 0]
    first_lengths, second_lengths = (np.sqrt(np.einsum("ei,ei->e", vectors, vectors)) + TINY for vectors in (first, second))
    double_areas = np.sqrt(np.einsum("ei,ei->e", *[np.cross(first, second)] * 2))
    tangents = half_angle_tangents(first, second, first_lengths, second_lengths, double_areas, 1e-12) + 1e-12
    first_weights, second_weights = tangents / first_lengths, tangents / second_lengths
    totals = rings.sum_over_rings(first_weights + second_weights)
    positions = rings.sum_over_rings(first_weights[:, None] * rings.first + second_weights[:, None] * rings.second) / totals[:, None]
    open_rings = rings.ring[first_edges]
    t = (first_lengths[first_edges] / (first_lengths[first_edges] + second_lengths[last_edges]))[:, None]
    positions[open_rings] = (1.0 - t) * rings.first[first_edges] + t * rings.second[last_edges]
    return positions


def _move_inside(rings: OneRings, positions: np.ndarray, bases: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Replace `positions` (N, 2) outside their rings by points on the lines from `bases` along `directions` (N, 2), halved until inside."""
    is_outside = rings.clearance(positions)[0] <= 0.0
    for _ in range(MAX_HALVINGS):
        if not is_outside.any():
            break
        positions = np.where(is_outside[:, None], bases + directions, positions)
        directions = 0.5 * directions
        is_outside = rings.clearance(positions)[0] <= 0.0
    return positions


def _open_ring_ends(ring: np.ndarray, edges: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last edges (O,) of the open rings, those of boundary vertices, as indices into `edges` (P, 2)."""
    first, second = ring.astype(np.int64) * vertex_count + edges[:, 0], ring.astype(np.int64) * vertex_count + edges[:, 1]
    return np.flatnonzero(~np.isin(first, second)), np.flatnonzero(~np.isin(second, first))
