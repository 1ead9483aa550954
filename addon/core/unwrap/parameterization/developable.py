"""Unfolds developable charts without stretch: flat parts, bent leaves, folded sheets, and cylinders and cones that are cut open."""

import numpy as np

from ...geometry.edges import Edges, find_edges
from ...jobs.chunks import slices
from ...jobs.progress import Progress, Steps
from ..cutting.chart import Chart
from ..energies.boundary_barrier import overlaps_itself

MAX_ANGLE_DEFECT = 3e-3  # Radians: difference of the angle sum around an interior vertex from 2 pi.
MAX_LENGTH_CHANGE = 1e-3  # Relative to an edge's length.
CHUNK_SIZE = 1 << 17  # Triangles.
FRONTS_PER_YIELD = 256  # Fronts of triangles that are unfolded between two progress reports.


def unfold_developable(chart: Chart) -> Steps[np.ndarray | None]:
    """Return an isometric uv (V, 2) of a chart of uniform density, without overlaps; None where there is none."""
    edges = find_edges(chart.triangles, len(chart.vertices))
    yield Progress(0.0, "Unfolding")
    if np.ptp(chart.density) > 0.0 or (yield from _has_angle_defect(chart, edges)):
        return None
    uv = yield from _unfold_triangles(chart, edges)
    uv_lengths, lengths = (np.linalg.norm(np.subtract(*positions[edges.ends.T]), axis=1) for positions in (uv, chart.vertices))
    if not (np.abs(uv_lengths - lengths) <= MAX_LENGTH_CHANGE * lengths).all():
        return None
    return None if overlaps_itself(uv, chart.triangles) else uv


def _has_angle_defect(chart: Chart, edges: Edges) -> Steps[bool]:
    """Return whether the angles around an interior vertex do not add up to 2 pi, or a triangle has no area."""
    angle_sums = np.zeros(edges.vertex_count)
    for rows in slices(len(chart.triangles), CHUNK_SIZE):
        yield Progress(0.0, "Unfolding")
        corners = chart.vertices[chart.triangles[rows]]
        to_next, to_previous = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        sines = np.linalg.norm(np.cross(to_next, to_previous), axis=2)
        if (sines == 0.0).any():
            return True
        angles = np.arctan2(sines, np.einsum("tci,tci->tc", to_next, to_previous))
        angle_sums += np.bincount(chart.triangles[rows].ravel(), angles.ravel(), edges.vertex_count)
    return bool((np.abs(angle_sums - 2.0 * np.pi)[~edges.boundary_vertices] > MAX_ANGLE_DEFECT).any())


def _unfold_triangles(chart: Chart, edges: Edges) -> Steps[np.ndarray]:
    """Return uv (V, 2) by unfolding front after front of triangles, starting at the first; the first triangle of a vertex places it."""
    triangles, twins = chart.triangles, np.full(3 * len(chart.triangles), -1)
    twins[edges.interior_halfedges] = edges.interior_halfedges[:, ::-1]
    uv, is_placed, is_done = np.zeros((edges.vertex_count, 2)), np.zeros(edges.vertex_count, bool), np.zeros(len(triangles), bool)
    first, second, _ = triangles[0]
    uv[second, 0] = np.linalg.norm(chart.vertices[second] - chart.vertices[first])
    is_placed[[first, second]] = True
    front, front_count = np.array([2]), 0  # Halfedges with placed ends, of the triangles to unfold next.
    while len(front):
        if front_count % FRONTS_PER_YIELD == 0:
            yield Progress(is_done.mean(), "Unfolding")
        owners, corner = front // 3, front % 3
        apexes, starts, ends = (triangles[owners, (corner + offset) % 3] for offset in range(3))
        is_new = ~is_placed[apexes]
        uv[apexes[is_new]] = _place_apexes(chart.vertices, uv, apexes[is_new], starts[is_new], ends[is_new])
        is_placed[apexes], is_done[owners] = True, True
        halfedges = twins[(3 * owners[:, None] + np.arange(3)).ravel()]
        halfedges = halfedges[halfedges >= 0]
        halfedges = halfedges[~is_done[halfedges // 3]]
        front = halfedges[np.unique(halfedges // 3, return_index=True)[1]]
        front_count += 1
    return uv


def _place_apexes(vertices: np.ndarray, uv: np.ndarray, apexes: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return positions (N, 2) of the vertices `apexes`, to the left of the edges from `starts` to `ends`, which are placed already."""
    base, side = vertices[ends] - vertices[starts], vertices[apexes] - vertices[starts]
    squares = np.einsum("ni,ni->n", base, base)
    along = np.einsum("ni,ni->n", base, side) / squares
    across = np.linalg.norm(np.cross(base, side), axis=1) / squares
    edges = uv[ends] - uv[starts]
    return uv[starts] + along[:, None] * edges + across[:, None] * (edges[:, ::-1] * [-1.0, 1.0])
