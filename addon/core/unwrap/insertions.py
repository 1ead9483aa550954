"""Vertices put back into a layout from which they had been taken, one round of collapses at a time, without flipping a triangle."""

import numpy as np

from .collapses import Round
from .polygons import Polygons

LEAST_ROOM = 0.05  # of the root of its polygon's area: a place nearer to an edge is not taken as it is
TRIES = 8  # to find a better place before the sure one is taken
HALVINGS = 48


def inserted(layout: np.ndarray, made: Round, vertices: np.ndarray) -> np.ndarray:
    """A layout (V, 2) of the mesh after a round of collapses as one of the mesh before it, in which no triangle is flipped either.

    vertices: (V, 3) float64, on the surface. A vertex of the border comes to lie in proportion between its neighbours there.
    """
    polygons = Polygons(layout, made.removed, made.stars, vertices, np.ones(len(vertices)))
    kept = layout[made.kept]
    size = np.sqrt(np.maximum(polygons.total(polygons.doubled(kept)), 0.0))
    places = _predicted(polygons, len(vertices))
    wanted = LEAST_ROOM * size
    for _ in range(TRIES):
        room, nearest = polygons.room(places)
        short = np.flatnonzero(room < wanted)
        if len(short) == 0:
            break
        lacking = 1.5 * (wanted - room)[short, None]
        places[short] += lacking * polygons.inward()[nearest[short]]
    layout = layout.copy()
    layout[made.removed] = _surely_inside(polygons, places, kept, (polygons.edges == made.kept[polygons.polygon, None]).any(axis=1), size)
    return layout


def _predicted(polygons: Polygons, count: int) -> np.ndarray:
    """Places (N, 2) by the mean value coordinates that vertices have on the surface; on a border, in proportion along it."""
    first, second = polygons.corners[:, 1] - polygons.corners[:, 0], polygons.corners[:, 2] - polygons.corners[:, 0]
    near, far = (np.sqrt(np.einsum("ei,ei->e", each, each)) + 1e-300 for each in (first, second))
    sine = np.sqrt(np.einsum("ei,ei->e", *[np.cross(first, second)] * 2))
    half = sine / np.maximum(near * far + np.einsum("ei,ei->e", first, second), 1e-12 * near * far) + 1e-12
    total = polygons.total(half / near + half / far)
    places = polygons.total((half / near)[:, None] * polygons.first + (half / far)[:, None] * polygons.second) / total[:, None]
    begin, end = _ends(polygons.polygon, polygons.edges, count)
    opened = polygons.polygon[begin]
    share = (near[begin] / (near[begin] + far[end]))[:, None]
    places[opened] = (1.0 - share) * polygons.first[begin] + share * polygons.second[end]
    return places


def _surely_inside(polygons: Polygons, places: np.ndarray, kept: np.ndarray, at_kept: np.ndarray, size: np.ndarray) -> np.ndarray:
    """`places` (N, 2), but for those that are not inside: these go so near to the kept vertex that they are."""
    lost = polygons.room(places)[0] <= 0.0
    inward = polygons.total(np.where(at_kept[:, None], polygons.inward(), 0.0))
    length = size.copy()
    for _ in range(HALVINGS):
        if not lost.any():
            break
        places = np.where(lost[:, None], kept + length[:, None] * inward, places)
        length *= 0.5
        lost = polygons.room(places)[0] <= 0.0
    return places


def _ends(polygon: np.ndarray, edges: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last edge of every open polygon, those of vertices on a border, as places among `edges` (P, 2)."""
    first, second = polygon.astype(np.int64) * count + edges[:, 0], polygon.astype(np.int64) * count + edges[:, 1]
    return np.flatnonzero(~np.isin(first, second)), np.flatnonzero(~np.isin(second, first))
