"""Chooses edges that cut a surface open to a disk: short paths through areas of low density and along creases.

Handles are cut along the shortest loops of a shortest-path tree plus the edges that neither it nor its dual tree contains (Erickson,
Whittlesey: Greedy optimal homotopy and homology generators, 2005). A closed surface is cut between two distant vertices and then to the
most stretched vertex of a decimated proxy, as long as this reduces stretch (Gu, Gortler, Hoppe: Geometry images, 2002, section 3.2).
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from ...arrays import TINY
from ...errors import GeometryError
from ...geometry.edges import Edges, find_edges
from ...geometry.mesh import face_areas_and_normals
from ...jobs.progress import Progress, Steps, run_to_end, subprogress
from ..energies.rest_shapes import compute_rest_shapes
from ..energies.stretch_energy import StretchEnergy, squared_stretches
from ..multiresolution.halfedge_decimation import decimate
from ..parameterization.parameterize import EXPANSIONS, Balance, Boundary, parameterize
from .boundaries import boundary_loops
from .chart import Chart, split_into_components

CREASE_DISCOUNT = 0.8  # A cut along an edge that is folded by 180 degrees saves this fraction of its cost.
DENSITY_POWER = 2.0  # Of the density in the cost of a cut, so that cuts avoid what cameras see even where that is a detour.
BOUNDARY_COST = 100.0  # Cost factor of edges at the boundary when handles are cut, so that the rest stays connected.
INSIDE_POLYGON_COST = 1e6  # Cost factor of edges inside a polygon.
MAX_FILLED_HOLE = 0.01  # A hole that encloses a larger fraction of the area, as a circle, is connected to the boundary instead of filled.
PROXY_VERTICES = 600  # Vertices of the decimated mesh.
POOR_EXCESS = (
    1.0  # Of symmetric Dirichlet energy. Above it parameterizations say little about where to cut, and cutting continues in any case.
)
MAX_ENDPOINTS, MAX_ENDPOINTS_WHILE_POOR = 10, 12  # Maximum endpoints of cuts from where the stretch is no longer poor, and until then.
MIN_RELATIVE_GAIN, MIN_GAIN = 0.1, 0.02  # Further cuts must reduce the excess by so much each, relative and absolute.


def cut_to_disk_edges(chart: Chart, edges: Edges, further_cuts: bool, is_distorted: bool) -> Steps[np.ndarray]:
    """Return which `edges` (E,) bool to cut next to turn a chart into a disk, possibly with small holes; none if it is one.

    Args:
        chart: a connected and oriented manifold of any genus, closed or not.
        edges: of the chart.
        further_cuts: also cut charts of uneven density and distorted charts.
        is_distorted: whether the chart is strongly distorted in one piece.
    """
    loops = boundary_loops(chart.triangles, chart.vertices)
    handles = 2 - len(loops) - (len(chart.vertices) - len(edges.ends) + len(chart.triangles))
    openings = _opening_areas(chart, loops)
    is_large_hole = openings[1:] > MAX_FILLED_HOLE
    further_cuts = further_cuts and (is_distorted or float(np.ptp(chart.density)) > 0.0)
    if not handles and loops and not is_large_hole.any() and not further_cuts:
        return np.zeros(len(edges.ends), bool)
    yield Progress(0.0, "Finding cuts")
    paths = _ShortestPaths(chart, edges)
    if handles:
        return paths.homology_generators(edges.boundary_vertices)
    if is_large_hole.any():
        return paths.connect_loops(loops[0], [loop for loop, is_large in zip(loops[1:], is_large_hole, strict=True) if is_large])
    start = loops[0] if loops else paths.farthest_pair()[:1]
    endpoints = yield from _find_endpoints(chart, start, 0 if loops else 1)
    return paths.paths_to(start, endpoints)


def _opening_areas(chart: Chart, loops: list[np.ndarray]) -> np.ndarray:
    """Return the area (L,) that each of the loops encloses as a circle, as a fraction of the chart's area."""
    area = float(face_areas_and_normals(chart.vertices[chart.triangles])[0].sum())
    lengths = [float(np.linalg.norm(np.roll(chart.vertices[loop], -1, axis=0) - chart.vertices[loop], axis=1).sum()) for loop in loops]
    return np.array(lengths) ** 2 / max(4.0 * np.pi * area, TINY)


class _ShortestPaths:
    """Shortest paths along the edges of a chart, by the cost of cutting them. Cuts are (E,) bool."""

    def __init__(self, chart: Chart, edges: Edges) -> None:
        self._chart, self._edges = chart, edges
        self._lengths = np.linalg.norm(np.subtract(*chart.vertices[edges.ends.T]), axis=1)
        self._lengths = np.maximum(self._lengths, 1e-6 * self._lengths.mean() or 1.0)
        self._costs = self._lengths * cut_cost(chart, edges)
        self._densities = _average_at_vertices(chart)

    def paths_to(self, start: np.ndarray, endpoints: Sequence[int]) -> np.ndarray:
        """Return paths from the vertices `start` (S,) to each of `endpoints` in order; a path may branch off from earlier ones."""
        cut = np.zeros(len(self._edges.ends), bool)
        for endpoint in endpoints:
            cut = self.extend(cut, start, endpoint)
        return cut

    def extend(self, cut: np.ndarray, start: np.ndarray, endpoint: int) -> np.ndarray:
        """Return `cut` plus the shortest path to `endpoint` from it or from the vertices `start` (S,)."""
        cut = cut.copy()
        self._add_path(cut, self._graph(self._costs), np.union1d(start, self._edges.ends[cut]), endpoint)
        return cut

    def connect_loops(self, boundary: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
        """Return paths that connect `loops` to the `boundary`."""
        cut = np.zeros(len(self._edges.ends), bool)
        graph = self._graph(np.where(self._edges.face_counts == 1, 1e-9 * self._costs, self._costs))  # Following the boundary cuts nothing.
        for loop in loops:
            self._add_path(cut, graph, np.union1d(boundary, self._edges.ends[cut].ravel()), int(loop[0]))
        return cut & (self._edges.face_counts == 2)

    def farthest_pair(self) -> np.ndarray:
        """Return two vertices (2,) of low density that are approximately the farthest from each other."""
        graph = self._graph(self._lengths)
        first, second = 0, 0
        for _ in range(3):
            distances = dijkstra(graph, directed=False, indices=second)
            first, second = second, int(np.argmax(distances / self._densities))
        return np.array([first, second])

    def distances(self, start: np.ndarray) -> np.ndarray:
        """Return the lengths (V,) of the shortest paths to each vertex from the vertices `start` (S,)."""
        return dijkstra(self._graph(self._lengths), directed=False, indices=start, min_only=True)

    def homology_generators(self, is_boundary: np.ndarray) -> np.ndarray:
        """Return loops through a common vertex that cut all handles open. is_boundary: (V,) bool."""
        ends = self._edges.ends
        costs = np.where(is_boundary[ends].any(axis=1), BOUNDARY_COST * self._costs, self._costs)
        graph = self._graph(costs)
        best, min_cost = None, np.inf
        for root in {*self.farthest_pair().tolist(), int(np.argmin(np.bincount(ends.ravel(), np.repeat(costs, 2))))}:
            cut = self._loops_through(root, graph, costs)
            if costs[cut].sum() < min_cost:
                best, min_cost = cut, float(costs[cut].sum())
        return best

    def _loops_through(self, root: int, graph: csr_array, costs: np.ndarray) -> np.ndarray:
        ends = self._edges.ends
        distances, predecessors = dijkstra(graph, directed=False, indices=root, return_predecessors=True)
        in_tree = np.zeros(len(ends), bool)
        in_tree[self._edges.between(np.flatnonzero(predecessors >= 0), predecessors[predecessors >= 0])] = True
        in_neither_tree = ~in_tree
        in_neither_tree[self._dual_spanning_tree(~in_tree, distances[ends].sum(axis=1) + costs)] = False
        cut = in_neither_tree & (self._edges.face_counts == 2)
        for endpoint in np.unique(ends[cut]):
            self._backtrack(cut, predecessors, int(endpoint))
        return self._prune_dead_ends(cut)

    def _dual_spanning_tree(self, is_candidate: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Return the edges crossed by the maximum spanning tree of the dual graph.

        Args:
            is_candidate: (E,) bool, edges that the tree may cross.
            lengths: (E,) maximized.

        Every boundary loop counts as one more triangle.
        """
        triangles = self._chart.triangles
        count = len(triangles)
        adjacent = np.full((len(is_candidate), 2), -1)
        adjacent[self._edges.interior] = self._edges.interior_halfedges // 3
        boundary = np.flatnonzero(self._edges.face_counts == 1)
        loop_nodes = np.full(len(self._chart.vertices), -1)
        for index, loop in enumerate(boundary_loops(triangles, self._chart.vertices)):
            loop_nodes[loop] = count + index
            count_with_loops = count + index + 1
        owner = np.empty(len(is_candidate), np.int64)
        owner[self._edges.face_edges.ravel()] = np.repeat(np.arange(count), 3)
        adjacent[boundary] = np.column_stack([owner[boundary], loop_nodes[self._edges.ends[boundary, 0]]])
        candidates = np.flatnonzero(is_candidate)
        size = count_with_loops if len(boundary) else count
        ranks = np.empty(len(candidates))
        ranks[np.argsort(-lengths[candidates], kind="stable")] = np.arange(1, len(candidates) + 1)
        low, high = adjacent[candidates].min(axis=1), adjacent[candidates].max(axis=1)
        order = np.lexsort((ranks, high, low))  # The longer of two edges between the same triangles comes first.
        is_first = np.ones(len(order), bool)
        is_first[1:] = (np.diff(low[order]) != 0) | (np.diff(high[order]) != 0)
        order = order[is_first]
        tree = minimum_spanning_tree(coo_array((ranks[order], (low[order], high[order])), shape=(size, size)).tocsr())
        return candidates[np.isin(ranks, tree.data)]

    def _prune_dead_ends(self, cut: np.ndarray) -> np.ndarray:
        ends = self._edges.ends
        while True:
            degrees = np.bincount(ends[cut].ravel(), minlength=len(self._chart.vertices))
            is_dead_end = cut & (degrees[ends] == 1).any(axis=1)
            if not is_dead_end.any():
                return cut
            cut = cut & ~is_dead_end

    def _add_path(self, cut: np.ndarray, graph: csr_array, sources: np.ndarray, endpoint: int) -> None:
        _, predecessors, _ = dijkstra(graph, directed=False, indices=sources, return_predecessors=True, min_only=True)
        self._backtrack(cut, predecessors, endpoint)

    def _backtrack(self, cut: np.ndarray, predecessors: np.ndarray, endpoint: int) -> None:
        """Add the path that leads to `endpoint` by `predecessors` (V,) to `cut`."""
        path = [endpoint]
        while predecessors[path[-1]] >= 0:
            path.append(int(predecessors[path[-1]]))
        path = np.array(path)
        cut[self._edges.between(path[1:], path[:-1])] = True

    def _graph(self, costs: np.ndarray) -> csr_array:
        return csr_array((costs, tuple(self._edges.ends.T)), shape=(len(self._chart.vertices),) * 2)


def cut_cost(chart: Chart, edges: Edges) -> np.ndarray:
    """Return the cost per length (E,) of cutting each edge: lower on creases and where the density is low."""
    _, normals = face_areas_and_normals(chart.vertices[chart.triangles])
    interior, (first, second) = edges.interior, edges.interior_halfedges.T // 3
    costs = np.ones(len(edges.ends))
    costs[interior] = 1.0 - CREASE_DISCOUNT * 0.5 * (1.0 - np.einsum("ei,ei->e", normals[first], normals[second]))
    costs[interior] *= (chart.density[first] * chart.density[second]) ** (0.5 * DENSITY_POWER)
    if chart.polygon_ids is not None:
        costs[interior[chart.polygon_ids[first] == chart.polygon_ids[second]]] *= INSIDE_POLYGON_COST
    return costs


def _average_at_vertices(chart: Chart) -> np.ndarray:
    """Return the geometric mean (V,) of the densities of the triangles at each vertex."""
    corners = chart.triangles.ravel()
    return np.exp(np.bincount(corners, np.repeat(np.log(chart.density), 3)) / np.bincount(corners))


def _find_endpoints(chart: Chart, start: np.ndarray, required: int) -> Steps[list[int]]:
    """Return the vertices that cuts from the vertices `start` (S,) should lead to.

    The first is the farthest vertex, if `required` is 1 because the chart is closed. The next ones are where a decimated proxy is most
    stretched and far from the cut, as long as this reduces stretch enough. There are none if no cut leads to a good parameterization in one
    piece, such as for a tree with many branches.
    """
    is_kept = np.zeros(len(chart.vertices), bool)
    is_kept[start] = True
    coarse, _ = yield from subprogress(decimate(chart.vertices, chart.triangles, PROXY_VERTICES, is_kept), 0.0, 0.5)
    proxy, used = _build_proxy(chart, coarse)
    edges = find_edges(proxy.triangles, len(used))
    paths = _ShortestPaths(proxy, edges)
    start, densities = np.searchsorted(used, start), _average_at_vertices(proxy)
    endpoints, useful_count, best = [int((paths.distances(start) / densities).argmax())] * required, required, np.inf
    cut, max_count = paths.paths_to(start, endpoints), MAX_ENDPOINTS_WHILE_POOR
    while len(endpoints) <= max_count:
        yield Progress(0.5 + 0.5 * len(endpoints) / (max_count + 1), "Finding cuts")
        excess, stretch = _stretch_after_cut(proxy, edges, cut)
        if best < POOR_EXCESS and best - excess < max(MIN_RELATIVE_GAIN * best, MIN_GAIN):
            break
        if excess < POOR_EXCESS <= best:
            max_count = len(endpoints) + MAX_ENDPOINTS
        useful_count, best = len(endpoints), excess
        for _ in range(1 if best < POOR_EXCESS else 1 + len(endpoints) // 2):
            distances = paths.distances(np.union1d(start, edges.ends[cut]))
            endpoints.append(int(((np.sqrt(stretch) if best < POOR_EXCESS else 1.0) * distances / densities).argmax()))
            cut = paths.extend(cut, start, endpoints[-1])
    return used[endpoints[: useful_count if best < POOR_EXCESS else required]].tolist()


def _stretch_after_cut(proxy: Chart, edges: Edges, cut: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the distortion of a `proxy` that is `cut` (E,) bool along some of its `edges`, and the squared stretch (V,) at vertices.

    Distortion is the excess of symmetric Dirichlet energy. Squared stretch is relative to the density; vertices outside of the first part
    of the cut proxy have the mean. Infinite excess and stretch 1 where the proxy cannot be parameterized.
    """
    disk, members = split_into_components(proxy, edges.interior_halfedges[~cut[edges.interior]])[0]
    try:
        uv = run_to_end(parameterize(disk, Boundary.FREE, 0.0, Balance.BALANCED, is_rough=True))
    except GeometryError:
        return np.inf, np.ones(len(proxy.vertices))
    shapes = compute_rest_shapes(disk.vertices[disk.triangles])
    stretch = disk.density * squared_stretches(shapes, disk.triangles, uv)
    corners, areas = proxy.triangles[members].ravel(), np.repeat(shapes.areas, 3)
    weighted = np.bincount(corners, areas * np.repeat(stretch, 3), len(proxy.vertices))
    total = np.bincount(corners, areas, len(proxy.vertices))
    mean = weighted.sum() / max(total.sum(), TINY)
    energy = StretchEnergy(disk.triangles, shapes, disk.density**2, EXPANSIONS[Balance.BALANCED])
    return energy.distortion_excess(uv), np.where(total > 0.0, weighted / np.maximum(total, TINY), mean)


def _build_proxy(chart: Chart, triangles: np.ndarray) -> tuple[Chart, np.ndarray]:
    """Return the chart of `triangles` between some of its vertices, and the indices of these vertices."""
    used, indices = np.unique(triangles, return_inverse=True)
    log_density = np.log(_average_at_vertices(chart))
    proxy = Chart(chart.vertices[used], indices.reshape(-1, 3).astype(np.int32), np.exp(log_density[triangles].mean(axis=1)))
    return proxy, used
