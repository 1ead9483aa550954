"""Relaxes single vertices where a UV map is distorted most, since a few nearly flat triangles would limit every step of all vertices."""

import numpy as np

from ...geometry.collapses import select_independent
from ..energies.rest_shapes import RestShapes
from ..energies.stretch_energy import compute_jacobians
from .halfedge_decimation import SELECTION_PASSES, vertex_links
from .one_rings import OneRings

MAX_ENERGY_RATIO = 3.0  # Corners of triangles with a higher ratio of energy to its lower bound are relaxed.
NEWTON_STEPS = 2  # Per vertex.


def relax_worst_vertices(
    uv: np.ndarray,
    triangles: np.ndarray,
    vertices: np.ndarray,
    shapes: RestShapes,
    weights: np.ndarray,
    is_fixed: np.ndarray,
    symmetry: float,
) -> np.ndarray:
    """Return uv (V, 2) with fewer strongly distorted triangles; the same array where there are none.

    Args:
        triangles: (T, 3) with their rest `shapes`.
        vertices: (V, 3).
        weights: (V,) importance.
        is_fixed: (V,) bool.
        symmetry: of the energy.
    """
    triangle_weights = weights[triangles].mean(axis=1)
    jacobians = compute_jacobians(shapes, triangles, uv)
    determinants = jacobians.determinants
    energies = 0.5 * triangle_weights * jacobians.frobenius_squared / determinants**2
    energies += (1.0 - symmetry) * determinants + 0.5 * symmetry * jacobians.frobenius_squared
    is_distorted = energies > MAX_ENERGY_RATIO * 2.0 * np.sqrt(triangle_weights)
    is_selected = np.zeros(len(uv), bool)
    is_selected[triangles[is_distorted]] = True
    is_selected &= ~is_fixed
    if not is_selected.any():
        return uv
    uv = uv.copy()
    adjacent = triangles[is_selected[triangles].any(axis=1)]
    for centers in partition_into_independent_sets(adjacent, np.flatnonzero(is_selected)):
        rings = OneRings(uv, centers, vertex_links(adjacent, centers, len(uv)), vertices, weights, symmetry)
        uv[centers] = rings.relax(uv[centers], NEWTON_STEPS)
    return uv


def partition_into_independent_sets(triangles: np.ndarray, vertices: np.ndarray) -> list[np.ndarray]:
    """Partition the ascending `vertices` (N,) of `triangles` (T, 3) into sets of which no two vertices are adjacent."""
    corners = np.ascontiguousarray(triangles.T, np.intp)
    count = int(triangles.max(initial=-1)) + 1
    sets = []
    while len(vertices):
        sets.append(np.sort(select_independent(vertices, vertices, corners, count, SELECTION_PASSES)))
        vertices = np.setdiff1d(vertices, sets[-1], assume_unique=True)
    return sets
