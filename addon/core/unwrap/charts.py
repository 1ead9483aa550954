"""A surface taken apart into charts, disks or disks with holes, along its seams and wherever no plane could hold it."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree

from ..edges import edges_of
from ..progress import Progress, Steps, scaled
from ..spatial import keys_of
from .chart import Chart
from .cuts import opening_edges
from .splitting import apart

TRIES = 4  # of cutting a part open before it is unfolded triangle by triangle


@dataclass(frozen=True)
class Piece:
    """A chart and the triangles (K,) of the surface that it is made of, in the order of its own."""

    chart: Chart
    triangles: np.ndarray


def pieces_of(surface: Chart, seams: np.ndarray, further: bool = True) -> Steps[list[Piece]]:
    """The charts of a surface, which need not be a manifold, the one with most triangles first.

    seams: (S, 2), vertices joined by edges that are cut.

    Edges of more than two triangles are cut, and those between triangles wound against each other, of which one would be mirrored in the
    plane; vertices where parts only touch are split, and what is closed or has handles is cut open.

    further: parts without seams that are all but closed are cut as if they were closed.
    """
    triangles, cutting = surface.triangles, Progress(0.0, "Cutting")
    edges = edges_of(triangles, len(surface.vertices))
    yield cutting
    is_seam = np.isin(edges.keys, keys_of(*np.reshape(seams, (-1, 2)).T, edges.count))
    sides = edges.inner_sides[_agree(triangles, edges.inner_sides) & ~is_seam[edges.inner]]
    seamed = is_seam[edges.opposite].any(axis=1)
    yield cutting
    whole = apart(surface, sides)
    yield cutting
    total, done, pieces = len(triangles), 0, []
    for chart, members in whole:
        steps = _opened(chart, TRIES, further and not seamed[members].any())
        opened = yield from scaled(steps, done / total, (done + len(members)) / total)
        pieces += [Piece(part, members[own]) for part, own in opened]
        done += len(members)
    return sorted(pieces, key=lambda piece: -len(piece.triangles))


def _opened(chart: Chart, tries: int, further: bool) -> Steps[list[tuple[Chart, np.ndarray]]]:
    """Disks, or disks with holes, that a part of a surface is cut into, and which of its triangles each is made of."""
    edges = edges_of(chart.triangles, len(chart.vertices))
    yield Progress(0.0, "Cutting")
    sides = edges.inner_sides
    if tries > 0:
        is_cut = yield from opening_edges(chart, edges, further)
        cut = is_cut[edges.inner]
    else:
        cut = _unfolding(chart, sides)
    if not cut.any():
        return [(chart, np.arange(len(chart.triangles)))]
    parts = []
    for part, members in apart(chart, sides[~cut]):
        if tries == 0:
            parts.append((part, members))
        else:
            parts += [(opened, members[own]) for opened, own in (yield from _opened(part, tries - 1, False))]
    return parts


def _unfolding(chart: Chart, sides: np.ndarray) -> np.ndarray:
    """Which of `sides` (I, 2) to cut so that the rest joins the triangles as a tree: what always ends as a disk."""
    count, (first, second) = len(chart.triangles), sides.T // 3
    ranks = np.arange(1.0, len(sides) + 1)
    if chart.faces is not None:
        ranks[chart.faces[first] != chart.faces[second]] += len(sides)
    tree = minimum_spanning_tree(coo_array((ranks, (first, second)), shape=(count, count)))
    return ~np.isin(ranks, tree.data)


def _agree(triangles: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Whether the two triangles at each of `sides` (I, 2) go along it in different directions, (I,) bool."""
    starts = triangles.ravel()[3 * (sides // 3) + (sides % 3 + 1) % 3]
    return starts[:, 0] != starts[:, 1]
