"""Cuts a surface into charts, disks possibly with holes, along its seams and where it cannot be flattened."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree

from ...geometry.edges import find_edges
from ...geometry.proximity import encode_pairs
from ...jobs.progress import Progress, Steps, subprogress
from .chart import Chart, split_into_components, split_vertices
from .cuts import cut_to_disk_edges
from .welding import pair_doubled_edges

MAX_EXCESS = 0.3  # Of symmetric Dirichlet energy: charts with more in one piece are cut further.
MAX_DISK_ROUNDS = 4  # Before a component is cut along the complement of a spanning tree.


@dataclass(frozen=True)
class CutChart:
    """A chart, and the indices (T,) in the surface of its triangles.

    may_be_cut: whether it may be cut further, because it has no seams. max_excess: of symmetric Dirichlet energy, above which it is.
    """

    chart: Chart
    triangle_indices: np.ndarray
    may_be_cut: bool
    max_excess: float = MAX_EXCESS


def cut_into_charts(surface: Chart, seams: np.ndarray, further_cuts: bool = True) -> Steps[list[CutChart]]:
    """Return the charts of a surface, which may be non-manifold, sorted by decreasing number of triangles.

    Edges with more than two triangles are cut, and edges between triangles of opposite orientation, since one of them would be mirrored
    in the plane. Vertices where components only touch are split. Closed components and components with handles are cut open.

    Args:
        seams: (S, 2) vertices of edges that are always cut.
        further_cuts: cut components of uneven density without seams further, and let `cut_further` cut all that have none.
    """
    halfedges, has_seam = yield from connect_triangles(surface, seams)
    components = split_into_components(surface, halfedges)
    yield Progress(0.0, "Cutting")
    total, done, charts = len(surface.triangles), 0, []
    for component, members in components:
        may_be_cut = bool(further_cuts and not has_seam[members].any())
        steps = cut_to_disks(component, may_be_cut)
        disks = yield from subprogress(steps, done / total, (done + len(members)) / total)
        charts += [CutChart(disk, members[indices], may_be_cut) for disk, indices in disks]
        done += len(members)
    return sorted(charts, key=lambda cut: -len(cut.triangle_indices))


def connect_triangles(surface: Chart, seams: np.ndarray) -> Steps[tuple[np.ndarray, np.ndarray]]:
    """Return the pairs (I, 2) of halfedges, 3 t + c, where the surface is an oriented manifold and has none of `seams` (S, 2), vertices of
    edges; and which triangles (T,) bool are at a seam. Doubled vertices count as one."""
    triangles, progress = surface.triangles, Progress(0.0, "Cutting")
    edges = find_edges(triangles, len(surface.vertices))
    yield progress
    interior = edges.interior_halfedges
    doubled = pair_doubled_edges(surface.vertices, triangles, edges)
    yield progress
    is_seam = np.isin(edges.keys, encode_pairs(*np.reshape(seams, (-1, 2)).T, edges.vertex_count))[edges.face_edges]
    oriented = interior[_consistently_oriented(triangles, interior)]
    halfedges, is_doubled = np.concatenate([oriented, doubled]), np.arange(len(oriented) + len(doubled)) >= len(oriented)
    is_kept = ~is_seam.ravel()[halfedges].any(axis=1)
    for is_droppable in (is_doubled, np.ones(len(halfedges), bool)) if len(doubled) else ():
        corners = split_vertices(triangles, halfedges[is_kept])
        is_collapsed = (corners == np.roll(corners, 1, axis=1)).any(axis=1)  # Two vertices at the same position became one.
        is_kept &= ~(is_droppable & is_collapsed[halfedges // 3].any(axis=1))
    return halfedges[is_kept], is_seam.any(axis=1)


def cut_further(cut: CutChart) -> Steps[list[CutChart]]:
    """Return the charts of a strongly distorted chart that is cut towards its most distorted parts; only itself where that helps little."""
    disks = yield from cut_to_disks(cut.chart, True, True)
    return [CutChart(disk, cut.triangle_indices[indices], True, cut.max_excess) for disk, indices in disks]


def cut_to_disks(
    chart: Chart, further_cuts: bool, is_distorted: bool = False, rounds_left: int = MAX_DISK_ROUNDS
) -> Steps[list[tuple[Chart, np.ndarray]]]:
    """Cut a component into disks, possibly with holes; return each with the indices of its triangles."""
    edges = find_edges(chart.triangles, len(chart.vertices))
    yield Progress(0.0, "Cutting")
    halfedges = edges.interior_halfedges
    if rounds_left > 0:
        is_cut_edge = yield from cut_to_disk_edges(chart, edges, further_cuts, is_distorted)
        is_cut = is_cut_edge[edges.interior]
    else:
        is_cut = _spanning_tree_cut(chart, halfedges)
    if not is_cut.any():
        return [(chart, np.arange(len(chart.triangles)))]
    disks = []
    for component, members in split_into_components(chart, halfedges[~is_cut]):
        if rounds_left == 0:
            disks.append((component, members))
        else:
            disks += [
                (disk, members[indices]) for disk, indices in (yield from cut_to_disks(component, False, rounds_left=rounds_left - 1))
            ]
    return disks


def _spanning_tree_cut(chart: Chart, halfedges: np.ndarray) -> np.ndarray:
    """Return which of `halfedges` (I, 2) to cut so that the others connect the triangles as a tree, which always results in a disk."""
    count, (first, second) = len(chart.triangles), halfedges.T // 3
    ranks = np.arange(1.0, len(halfedges) + 1)
    if chart.polygon_ids is not None:
        ranks[chart.polygon_ids[first] != chart.polygon_ids[second]] += len(halfedges)
    tree = minimum_spanning_tree(coo_array((ranks, (first, second)), shape=(count, count)))
    return ~np.isin(ranks, tree.data)


def _consistently_oriented(triangles: np.ndarray, halfedges: np.ndarray) -> np.ndarray:
    """Return whether the two triangles at each of `halfedges` (I, 2) traverse the edge in opposite directions, (I,) bool."""
    starts = triangles.ravel()[3 * (halfedges // 3) + (halfedges % 3 + 1) % 3]
    return starts[:, 0] != starts[:, 1]
