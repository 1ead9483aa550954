"""Vertices put back into a layout from which they had been taken, one round of collapses at a time, without flipping a triangle."""

import numpy as np

from .collapses import Round
from .polygons import Polygons

LEAST_ROOM = 0.05  # of the root of its polygon's area: a place nearer to an edge is not taken as it is
TRIES = 8  # to find a better place before the sure one is taken
HALVINGS = 48


def inserted(layout: np.ndarray, made: Round, vertices: np.ndarray, bulge: float | None = None) -> np.ndarray:
    """A layout (V, 2) of the mesh after a round of collapses as one of the mesh before it, in which no triangle is flipped either.

    vertices: (V, 3) float64, on the surface. A vertex of the border comes to lie in proportion between its neighbours there, beside the
    line where its triangles need room. bulge: keeps the border from what is near it, by leaving that line outwards only where a triangle
    stands on it alone, and by no more than this share of its length.
    """
    polygons = Polygons(layout, made.removed, made.stars, vertices, np.ones(len(vertices)))
    kept = layout[made.kept]
    size = np.sqrt(np.maximum(polygons.total(polygons.doubled(kept)), 0.0))
    begin, end = _ends(polygons.polygon, polygons.edges, len(vertices))
    opened = polygons.polygon[begin]
    at_kept = (polygons.edges == made.kept[polygons.polygon, None]).any(axis=1)
    bases, ways = kept.copy(), size[:, None] * polygons.total(np.where(at_kept[:, None], polygons.inward(), 0.0))
    places, wanted = _predicted(polygons, begin, end), LEAST_ROOM * size
    if bulge is not None:
        from_first = polygons.edges[begin, 0] == made.kept[opened]
        bases[opened], ways[opened] = _close(polygons, begin, end, from_first, bulge)
        places[opened], wanted[opened] = bases[opened] + ways[opened], -np.inf
    for _ in range(TRIES):
        room, nearest = polygons.room(places)
        short = np.flatnonzero(room < wanted)
        if len(short) == 0:
            break
        lacking = 1.5 * (wanted - room)[short, None]
        places[short] += lacking * polygons.inward()[nearest[short]]
    layout = layout.copy()
    layout[made.removed] = _surely_inside(polygons, places, bases, ways)
    return layout


def _close(polygons: Polygons, begin: np.ndarray, end: np.ndarray, from_first: np.ndarray, bulge: float) -> tuple[np.ndarray, np.ndarray]:
    """Where vertices of a border begin, and their ways (O, 2) from there, close to the line between their neighbours on it: from the kept
    one towards the other where all between them is seen from there, else midway between that and the kept one's own edge. A vertex of one
    triangle alone goes from the middle of that line outwards.

    from_first: (O,) bool, whether the kept one is at the first edge of the open polygon, or at the last.
    """
    first, last = polygons.first[begin], polygons.second[end]
    kept, other = np.where(from_first[:, None], first, last), np.where(from_first[:, None], last, first)
    beside = np.where(from_first[:, None], polygons.second[begin], polygons.first[end])
    chord, edge = other - kept, beside - kept
    lengths, own = (np.maximum(np.hypot(*each.T), 1e-300)[:, None] for each in (chord, edge))
    seen = np.where(from_first, 1.0, -1.0) * (edge[:, 0] * chord[:, 1] - edge[:, 1] * chord[:, 0]) > 0.0
    ways = np.where(seen[:, None], 0.5 * chord, -np.minimum(lengths, own) * (chord / lengths + edge / own))
    alone = (begin == end)[:, None]
    outwards = bulge * lengths * polygons.inward()[begin]
    return np.where(alone, 0.5 * (kept + other), kept), np.where(alone, outwards, ways)


def _predicted(polygons: Polygons, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Places (N, 2) by the mean value coordinates that vertices have on the surface; on a border, in proportion along it.

    begin, end: the first and the last edge of every open polygon.
    """
    first, second = polygons.corners[:, 1] - polygons.corners[:, 0], polygons.corners[:, 2] - polygons.corners[:, 0]
    near, far = (np.sqrt(np.einsum("ei,ei->e", each, each)) + 1e-300 for each in (first, second))
    sine = np.sqrt(np.einsum("ei,ei->e", *[np.cross(first, second)] * 2))
    half = sine / np.maximum(near * far + np.einsum("ei,ei->e", first, second), 1e-12 * near * far) + 1e-12
    total = polygons.total(half / near + half / far)
    places = polygons.total((half / near)[:, None] * polygons.first + (half / far)[:, None] * polygons.second) / total[:, None]
    opened = polygons.polygon[begin]
    share = (near[begin] / (near[begin] + far[end]))[:, None]
    places[opened] = (1.0 - share) * polygons.first[begin] + share * polygons.second[end]
    return places


def _surely_inside(polygons: Polygons, places: np.ndarray, bases: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """`places` (N, 2), but for those not inside: these go so short a part of their `ways` (N, 2) from their `bases` that they are."""
    lost = polygons.room(places)[0] <= 0.0
    for _ in range(HALVINGS):
        if not lost.any():
            break
        places = np.where(lost[:, None], bases + ways, places)
        ways = 0.5 * ways
        lost = polygons.room(places)[0] <= 0.0
    return places


def _ends(polygon: np.ndarray, edges: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last edge of every open polygon, those of vertices on a border, as places among `edges` (P, 2)."""
    first, second = polygon.astype(np.int64) * count + edges[:, 0], polygon.astype(np.int64) * count + edges[:, 1]
    return np.flatnonzero(~np.isin(first, second)), np.flatnonzero(~np.isin(second, first))
