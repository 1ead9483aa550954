"""Layouts mended vertex by vertex where they are worst, before all vertices are moved together: a few triangles that are squeezed flat
would keep every step of all others short."""

import numpy as np

from ..edges import Edges, edges_of
from .collapses import independent, stars_of
from .polygons import Polygons
from .rest_shapes import RestShapes
from .stretch_energy import jacobians

SQUEEZED = 3.0  # times the energy that a triangle has at least: above that its corners are moved
STEPS = 2  # of Newton for each vertex, each time that it has its turn


def mended(
    layout: np.ndarray, triangles: np.ndarray, vertices: np.ndarray, shapes: RestShapes, weights: np.ndarray, stays: np.ndarray
) -> np.ndarray:
    """A layout (V, 2) with fewer squeezed triangles; the same one where there are none.

    triangles: (T, 3) with their rest `shapes`, of `vertices` (V, 3). weights: (V,) importance. stays: (V,) bool, who must not be moved.
    """
    own = weights[triangles].mean(axis=1)
    at = jacobians(shapes, triangles, layout)
    areas = at.determinants
    squeezed = 0.5 * own * at.squares / areas**2 + areas > SQUEEZED * 2.0 * np.sqrt(own)
    chosen = np.zeros(len(layout), bool)
    chosen[triangles[squeezed]] = True
    chosen &= ~stays
    if not chosen.any():
        return layout
    layout = layout.copy()
    around = triangles[chosen[triangles].any(axis=1)]
    for owners in independent_sets(edges_of(around, len(layout)), np.flatnonzero(chosen)):
        polygons = Polygons(layout, owners, stars_of(around, owners, len(layout)), vertices, weights)
        layout[owners] = polygons.relaxed(layout[owners], STEPS)
    return layout


def independent_sets(edges: Edges, vertices: np.ndarray) -> list[np.ndarray]:
    """`vertices` (N,) in groups, of which no two in the same are neighbours."""
    groups = []
    while len(vertices):
        chosen = independent(vertices, edges)
        groups.append(vertices[chosen])
        vertices = np.delete(vertices, chosen)
    return groups
