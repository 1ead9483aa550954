"""Where a surface that no plane can hold is cut open: short ways through what matters little and along what is creased anyway.

Handles are cut along the shortest loops of a tree of shortest ways and of the edges that its dual tree leaves over (Erickson, Whittlesey:
Greedy optimal homotopy and homology generators, 2005). What is closed is cut between two far ends, and from there to wherever a thinned
model of it is stretched most, as long as that helps (Gu, Gortler, Hoppe: Geometry images, 2002, section 3.2).
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from ..edges import Edges, edges_of
from ..errors import GeometryError
from ..mesh import TriangleMesh, face_areas_and_normals
from ..progress import Progress, Steps, finish, scaled
from .atlas_seams import atlas_seams
from .borders import border_loops
from .chart import Chart
from .chart_layout import Border, chart_layout
from .collapses import thinned
from .rest_shapes import RestShapes, rest_shapes
from .splitting import apart
from .stretch_energy import StretchEnergy, stretches

CREASE = 0.8  # of the cost is saved by a cut along an edge folded flat
AWAY = 100.0  # times its cost counts an edge at the border when handles are cut: what is left should hang together
NEVER = 1e6  # times its cost counts an edge within a face
WIDE = 0.01  # of the area: a hole whose circle has more is joined with the border, not filled
ALL_BUT_CLOSED = 0.05  # of the area: what has only openings whose circles have less
MODEL = 600  # vertices of the thinned model
POOR = 1.0  # excess of stretch: above it layouts tell little, and cuts go on in any case
MOST_ENDS, MOST_ENDS_OF_POOR = 10, 12  # that a cut leads to, besides those before that
WORTH, LEAST_WORTH = 0.1, 0.02  # of the excess of stretch has to go with a further end, and so much of stretch at least


def opening_edges(chart: Chart, edges: Edges, further: bool) -> Steps[np.ndarray]:
    """Which `edges` (E,) bool of a chart have to be cut next on its way to a disk, or one with small holes; none where it is one.

    chart: a connected and oriented manifold, closed or not, of any genus. further: whether what is all but closed is cut
    like what is, and what matters less where more matters elsewhere.
    """
    loops = border_loops(chart.triangles, chart.vertices)
    handles = 2 - len(loops) - (len(chart.vertices) - len(edges.ends) + len(chart.triangles))
    openings = _openings(chart, loops)
    wide = openings[1:] > WIDE
    further = further and (openings.max(initial=0.0) < ALL_BUT_CLOSED or float(np.ptp(chart.density)) > 0.0)
    if not handles and loops and not wide.any() and not further:
        return np.zeros(len(edges.ends), bool)
    yield Progress(0.0, "Looking for cuts")
    ways = _Ways(chart, edges)
    if handles:
        return ways.around_handles(edges.on_border)
    if wide.any():
        return ways.joined(loops[0], [loop for loop, is_wide in zip(loops[1:], wide, strict=True) if is_wide])
    start = loops[0] if loops else ways.far_ends()[:1]
    ends = yield from _ends(chart, start, 0 if loops else 1)
    return _as_atlas(chart, edges) if ends is None else ways.leading_to(start, ends)


def _as_atlas(chart: Chart, edges: Edges) -> np.ndarray:
    """The `edges` (E,) bool along which a chart is cut into an atlas."""
    faces = np.arange(len(chart.triangles)) if chart.faces is None else chart.faces
    seams = atlas_seams(TriangleMesh(chart.vertices, chart.triangles), faces)
    cut = np.zeros(len(edges.ends), bool)
    cut[edges.between(*seams.T)] = True
    return cut


def _openings(chart: Chart, loops: list[np.ndarray]) -> np.ndarray:
    """What each of the loops (L,) encloses as a circle, as a share of the chart's area."""
    area = float(face_areas_and_normals(chart.vertices[chart.triangles])[0].sum())
    lengths = [float(np.linalg.norm(np.roll(chart.vertices[loop], -1, axis=0) - chart.vertices[loop], axis=1).sum()) for loop in loops]
    return np.array(lengths) ** 2 / max(4.0 * np.pi * area, 1e-300)


class _Ways:
    """Shortest ways along the edges of a chart, by what cutting them costs."""

    def __init__(self, chart: Chart, edges: Edges) -> None:
        self._chart, self._edges = chart, edges
        self._lengths = np.linalg.norm(np.subtract(*chart.vertices[edges.ends.T]), axis=1)
        self._lengths = np.maximum(self._lengths, 1e-6 * self._lengths.mean() or 1.0)
        self._costs = self._lengths * _dearness(chart, edges)

    def leading_to(self, start: np.ndarray, ends: Sequence[int]) -> np.ndarray:
        """Ways from the vertices `start` (S,) to each of `ends`, each as short as it can be where some are already: (E,) bool."""
        cut = np.zeros(len(self._edges.ends), bool)
        for end in ends:
            cut = self.leading_on(cut, start, end)
        return cut

    def leading_on(self, cut: np.ndarray, start: np.ndarray, end: int) -> np.ndarray:
        """`cut` (E,) bool, which the vertices `start` (S,) belong to, and the shortest way from there to `end`."""
        cut = cut.copy()
        self._add_way(cut, self._graph(self._costs), np.union1d(start, self._edges.ends[cut]), end)
        return cut

    def joined(self, border: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
        """Ways that join `loops` with the `border`: (E,) bool."""
        cut = np.zeros(len(self._edges.ends), bool)
        graph = self._graph(np.where(self._edges.uses == 1, 1e-9 * self._costs, self._costs))  # along the border nothing is cut
        for loop in loops:
            self._add_way(cut, graph, np.union1d(border, self._edges.ends[cut].ravel()), int(loop[0]))
        return cut & (self._edges.uses == 2)

    def far_ends(self) -> np.ndarray:
        """Two vertices (2,) far from each other."""
        graph = self._graph(self._lengths)
        end, other = 0, 0
        for _ in range(3):
            end, other = other, int(np.argmax(dijkstra(graph, directed=False, indices=other)))
        return np.array([end, other])

    def distances(self, start: np.ndarray) -> np.ndarray:
        """Lengths (V,) of the shortest ways to each vertex from the vertices `start` (S,)."""
        return dijkstra(self._graph(self._lengths), directed=False, indices=start, min_only=True)

    def around_handles(self, on_border: np.ndarray) -> np.ndarray:
        """Loops that meet in one vertex and leave no handle: (E,) bool."""
        ends = self._edges.ends
        costs = np.where(on_border[ends].any(axis=1), AWAY * self._costs, self._costs)
        graph = self._graph(costs)
        best, least = None, np.inf
        for root in {*self.far_ends().tolist(), int(np.argmin(np.bincount(ends.ravel(), np.repeat(costs, 2))))}:
            cut = self._loops_from(root, graph, costs)
            if costs[cut].sum() < least:
                best, least = cut, float(costs[cut].sum())
        return best

    def _loops_from(self, root: int, graph: csr_array, costs: np.ndarray) -> np.ndarray:
        ends = self._edges.ends
        distances, before = dijkstra(graph, directed=False, indices=root, return_predecessors=True)
        in_tree = np.zeros(len(ends), bool)
        in_tree[self._edges.between(np.flatnonzero(before >= 0), before[before >= 0])] = True
        left_over = ~in_tree
        left_over[self._dual_tree(~in_tree, distances[ends].sum(axis=1) + costs)] = False
        cut = left_over & (self._edges.uses == 2)
        for end in np.unique(ends[cut]):
            self._add_back(cut, before, int(end))
        return self._pruned(cut)

    def _dual_tree(self, crossed: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """The edges, of those that may be `crossed` (E,) bool, across which a tree of the longest joins all triangles; beyond every loop of
        the border lies one triangle more."""
        triangles = self._chart.triangles
        count = len(triangles)
        across = np.full((len(crossed), 2), -1)
        across[self._edges.inner] = self._edges.inner_sides // 3
        alone = np.flatnonzero(self._edges.uses == 1)
        number = np.full(len(self._chart.vertices), -1)
        for index, loop in enumerate(border_loops(triangles, self._chart.vertices)):
            number[loop] = count + index
            count_all = count + index + 1
        owner = np.empty(len(crossed), np.int64)
        owner[self._edges.opposite.ravel()] = np.repeat(np.arange(count), 3)
        across[alone] = np.column_stack([owner[alone], number[self._edges.ends[alone, 0]]])
        chosen = np.flatnonzero(crossed)
        size = count_all if len(alone) else count
        ranks = np.empty(len(chosen))
        ranks[np.argsort(-lengths[chosen], kind="stable")] = np.arange(1, len(chosen) + 1)
        low, high = across[chosen].min(axis=1), across[chosen].max(axis=1)
        order = np.lexsort((ranks, high, low))  # of two edges between the same triangles the longer one
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(low[order]) != 0) | (np.diff(high[order]) != 0)
        order = order[first]
        tree = minimum_spanning_tree(coo_array((ranks[order], (low[order], high[order])), shape=(size, size)).tocsr())
        return chosen[np.isin(ranks, tree.data)]

    def _pruned(self, cut: np.ndarray) -> np.ndarray:
        """`cut` without its dead ends."""
        ends = self._edges.ends
        while True:
            met = np.bincount(ends[cut].ravel(), minlength=len(self._chart.vertices))
            dead = cut & (met[ends] == 1).any(axis=1)
            if not dead.any():
                return cut
            cut = cut & ~dead

    def _add_way(self, cut: np.ndarray, graph: csr_array, sources: np.ndarray, end: int) -> None:
        _, before, _ = dijkstra(graph, directed=False, indices=sources, return_predecessors=True, min_only=True)
        self._add_back(cut, before, end)

    def _add_back(self, cut: np.ndarray, before: np.ndarray, end: int) -> None:
        """Add the way from `end` back to where `before` (V,), the vertex before each, begins."""
        way = [end]
        while before[way[-1]] >= 0:
            way.append(int(before[way[-1]]))
        way = np.array(way)
        cut[self._edges.between(way[1:], way[:-1])] = True

    def _graph(self, costs: np.ndarray) -> csr_array:
        return csr_array((costs, tuple(self._edges.ends.T)), shape=(len(self._chart.vertices),) * 2)


def _dearness(chart: Chart, edges: Edges) -> np.ndarray:
    """What a cut costs along every edge (E,) for its length: less on creases and where few texels are wanted."""
    _, normals = face_areas_and_normals(chart.vertices[chart.triangles])
    inner, (first, second) = edges.inner, edges.inner_sides.T // 3
    dearness = np.ones(len(edges.ends))
    dearness[inner] = 1.0 - CREASE * 0.5 * (1.0 - np.einsum("ei,ei->e", normals[first], normals[second]))
    dearness[inner] *= np.sqrt(chart.density[first] * chart.density[second])
    if chart.faces is not None:
        dearness[inner[chart.faces[first] == chart.faces[second]]] *= NEVER
    return dearness


def _ends(chart: Chart, start: np.ndarray, needed: int) -> Steps[list[int] | None]:
    """Vertices of a chart that cuts from the vertices `start` (S,) should lead to: at first the farthest, where one is `needed` to open it
    at all, then one after the other wherever a thinned model is stretched most and far from what is cut, as long as that takes a good part
    of the stretch; None where that leads to no good layout in one piece, such as of a tree with many branches."""
    stays = np.zeros(len(chart.vertices), bool)
    stays[start] = True
    coarse, _ = yield from scaled(thinned(chart.vertices, chart.triangles, MODEL, stays), 0.0, 0.5)
    model, used = _of(chart, coarse)
    edges = edges_of(model.triangles, len(used))
    ways = _Ways(model, edges)
    start = np.searchsorted(used, start)
    ends, worth, best = [int(ways.distances(start).argmax())] * needed, needed, np.inf
    cut, most = ways.leading_to(start, ends), MOST_ENDS_OF_POOR
    while len(ends) <= most:
        yield Progress(0.5 + 0.5 * len(ends) / (most + 1), "Looking for cuts")
        excess, stretch = _opened_along(model, edges, cut)
        if best < POOR and best - excess < max(WORTH * best, LEAST_WORTH):
            break
        if excess < POOR <= best:
            most = len(ends) + MOST_ENDS
        worth, best = len(ends), excess
        for _ in range(1 if best < POOR else 1 + len(ends) // 2):
            distances = ways.distances(np.union1d(start, edges.ends[cut]))
            ends.append(int(((np.sqrt(stretch) if best < POOR else 1.0) * distances).argmax()))
            cut = ways.leading_on(cut, start, ends[-1])
    return used[ends[:worth]].tolist() if best < POOR else None


def _opened_along(model: Chart, edges: Edges, cut: np.ndarray) -> tuple[float, np.ndarray]:
    """By how much the layout of a `model` is stretched that is `cut` (E,) open along some of its `edges`, and the squared stretch (V,)
    around its vertices beside what is wanted there; infinite and 1 where no layout of it is found."""
    opened, members = apart(model, edges.inner_sides[~cut[edges.inner]])[0]
    try:
        layout = finish(chart_layout(opened, Border.FREE, 0.0, rough=True))
    except GeometryError:
        return np.inf, np.ones(len(model.vertices))
    shapes = rest_shapes(opened.vertices[opened.triangles])
    stretch = opened.density * stretches(shapes, opened.triangles, layout)
    corners, areas = model.triangles[members].ravel(), np.repeat(shapes.areas, 3)
    around = np.bincount(corners, areas * np.repeat(stretch, 3), len(model.vertices))
    return _excess(opened, shapes, layout), around / np.bincount(corners, areas, len(model.vertices))


def _of(chart: Chart, triangles: np.ndarray) -> tuple[Chart, np.ndarray]:
    """The chart of some `triangles` of its vertices, and which of these it has."""
    used, own = np.unique(triangles, return_inverse=True)
    around = np.bincount(chart.triangles.ravel(), np.repeat(np.log(chart.density), 3)) / np.bincount(chart.triangles.ravel())
    return Chart(chart.vertices[used], own.reshape(-1, 3).astype(np.int32), np.exp(around[triangles].mean(axis=1))), used


def _excess(chart: Chart, shapes: RestShapes, layout: np.ndarray) -> float:
    """How much higher the energy of a `layout` is than without stretch, as a share."""
    energy = StretchEnergy(chart.triangles, shapes, chart.density**2)
    stretched, area = energy.parts(layout)
    return 2.0 * np.sqrt(stretched * area) / energy.least() - 1.0
