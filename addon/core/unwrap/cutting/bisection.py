"""Divides a chart into two parts of similar size by a short cut across the long side of its map."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from ...arrays import TINY
from ...geometry.edges import Edges, find_edges
from ...jobs.progress import Progress, Steps
from .chart import Chart, split_into_components
from .charts import CutChart, cut_to_disks
from .cuts import cut_cost

BAND = 0.3, 0.7  # The cut lies between these fractions of the length of the map.
CENTER_PREFERENCE = 0.5  # How much more a cut costs at an end than in the middle; of equal ones, the one in the middle is made.
CAPACITY = 1e6  # Integer capacity of the most expensive edge that may be cut.


def bisect_further(cut: CutChart, uv: np.ndarray | None) -> Steps[list[CutChart]]:
    """Return the charts of a chart that is cut across the long side of its map `uv` (V, 2), or in space without one; only itself where
    that is not possible."""
    chart = cut.chart
    positions = chart.vertices if uv is None else uv
    centered = positions - positions.mean(axis=0)
    axis = np.linalg.svd(centered.T @ centered)[0][:, 0]
    along = (centered @ axis)[chart.triangles].mean(axis=1)
    yield Progress(0.0, "Cutting")
    edges = find_edges(chart.triangles, len(chart.vertices))
    is_second = _bisect(chart, edges, (along - along.min()) / max(float(np.ptp(along)), TINY))
    yield Progress(0.0, "Cutting")
    halfedges = edges.interior_halfedges
    sides = is_second[halfedges // 3]
    parts, charts = split_into_components(chart, halfedges[sides[:, 0] == sides[:, 1]]), []
    for part, members in parts if len(parts) > 1 else ():
        disks = yield from cut_to_disks(part, False)
        charts += [CutChart(disk, cut.triangle_indices[members[indices]], True, cut.max_excess) for disk, indices in disks]
    return charts or [cut]


def _bisect(chart: Chart, edges: Edges, position: np.ndarray) -> np.ndarray:
    """Return which triangles (T,) bool are in the second part, after a minimum cut; polygons are not cut.

    position: (T,) along the map, 0 to 1.
    """
    first, second = edges.interior_halfedges.T // 3
    lengths = np.linalg.norm(np.subtract(*chart.vertices[edges.ends[edges.interior].T]), axis=1)
    costs = lengths * cut_cost(chart, edges)[edges.interior]
    costs *= 1.0 + CENTER_PREFERENCE * np.abs(position[first] + position[second] - 1.0)
    polygons = (
        np.arange(len(chart.triangles)) if chart.polygon_ids is None else np.unique(chart.polygon_ids, return_inverse=True)[1].ravel()
    )
    is_between = polygons[first] != polygons[second]
    count = int(polygons.max()) + 1
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, polygons, position)
    np.maximum.at(high, polygons, position)
    starts, ends = np.flatnonzero(low < BAND[0]), np.flatnonzero((high > BAND[1]) & (low >= BAND[0]))
    if not is_between.any() or len(starts) == 0 or len(ends) == 0:
        return np.zeros(len(chart.triangles), bool)
    first, second, costs = polygons[first[is_between]], polygons[second[is_between]], costs[is_between]
    capacities = np.maximum(CAPACITY * costs / costs.max(), 1.0)
    total = np.full(len(starts), 2.0 * CAPACITY), np.full(len(ends), 2.0 * CAPACITY)
    rows = np.concatenate([first, second, np.full(len(starts), count), ends])
    columns = np.concatenate([second, first, starts, np.full(len(ends), count + 1)])
    values = np.concatenate([capacities, capacities, *total]).astype(np.int32)
    graph = coo_array((values, (rows, columns)), shape=(count + 2,) * 2).tocsr()
    graph.sum_duplicates()
    residual = graph - maximum_flow(graph, count, count + 1).flow
    residual.data = np.where(residual.data > 0, 1, 0)
    residual.eliminate_zeros()
    reached = breadth_first_order(residual, count, return_predecessors=False)
    is_first = np.zeros(count + 2, bool)
    is_first[reached] = True
    return ~is_first[polygons]
