"""A surface taken apart into charts, disks or disks with holes, along its seams and wherever no plane could hold it."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from ..edges import edges_of
from ..progress import Steps, scaled
from ..spatial import keys_of
from .chart import Chart
from .cuts import opening_edges
from .splitting import apart

TRIES = 4  # of cutting a part open before it is unfolded triangle by triangle


@dataclass(frozen=True)
class Piece:
    """A chart and the triangles (K,) of the surface that it is made of, in the order of its own. turned: (K,) bool, those that are wound
    the other way there, so that the whole chart looks to one side."""

    chart: Chart
    triangles: np.ndarray
    turned: np.ndarray

    def corners(self, layout: np.ndarray) -> np.ndarray:
        """Corners (K, 3, 2) of the surface's triangles in a `layout` (V, 2) of the chart."""
        corners = layout[self.chart.triangles]
        return np.where(self.turned[:, None, None], corners[:, [0, 2, 1]], corners)


def pieces_of(surface: Chart, seams: np.ndarray, further: bool = True) -> Steps[list[Piece]]:
    """The charts of a surface, which need not be a manifold, the one with most triangles first.

    seams: (S, 2), vertices joined by edges that are cut.

    Edges of more than two triangles are cut, vertices where parts only touch are split, triangles wound against their neighbours are
    turned, and what is closed or has handles is cut open. further: parts without seams that are all but closed are cut as if they were
    closed.
    """
    turned = _turned(surface.triangles)
    triangles = np.where(turned[:, None], surface.triangles[:, [0, 2, 1]], surface.triangles)
    edges = edges_of(triangles, len(surface.vertices))
    is_seam = np.isin(edges.keys, keys_of(*np.reshape(seams, (-1, 2)).T, edges.count))
    sides = edges.inner_sides[_agree(triangles, edges.inner_sides) & ~is_seam[edges.inner]]
    seamed = is_seam[edges.opposite].any(axis=1)
    whole = apart(replace(surface, triangles=triangles), sides)
    total, done, pieces = len(triangles), 0, []
    for chart, members in whole:
        steps = _opened(chart, TRIES, further and not seamed[members].any())
        opened = yield from scaled(steps, done / total, (done + len(members)) / total)
        pieces += [Piece(part, members[own], turned[members[own]]) for part, own in opened]
        done += len(members)
    return sorted(pieces, key=lambda piece: -len(piece.triangles))


def _opened(chart: Chart, tries: int, further: bool) -> Steps[list[tuple[Chart, np.ndarray]]]:
    """Disks, or disks with holes, that a part of a surface is cut into, and which of its triangles each is made of."""
    edges = edges_of(chart.triangles, len(chart.vertices))
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


def _turned(triangles: np.ndarray) -> np.ndarray:
    """Which triangles (T,) bool have to be wound the other way for all to agree with their neighbours; fewer than half of a part, and none
    where a surface has but one side."""
    count = len(triangles)
    sides = edges_of(triangles).inner_sides
    first, second = sides.T // 3
    against = ~_agree(triangles, sides)
    if not against.any():
        return np.zeros(count, bool)
    ones = np.concatenate([first, first + count])
    others = np.concatenate([np.where(against, second + count, second), np.where(against, second, second + count)])
    _, label = connected_components(coo_array((np.ones(len(ones), bool), (ones, others)), shape=(2 * count,) * 2), directed=False)
    as_is, mirrored = label[:count], label[count:]
    kept = np.bincount(as_is, minlength=int(label.max(initial=-1)) + 1)
    return (kept[as_is] < kept[mirrored]) | ((kept[as_is] == kept[mirrored]) & (as_is > mirrored))


def _agree(triangles: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Whether the two triangles at each of `sides` (I, 2) go along it in different directions, (I,) bool."""
    starts = triangles.ravel()[3 * (sides // 3) + (sides % 3 + 1) % 3]
    return starts[:, 0] != starts[:, 1]
