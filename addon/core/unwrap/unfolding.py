"""Charts that unfold into the plane without any stretch: what is flat, bent leaves, folded sheets, rings and cones that are cut open."""

import numpy as np

from ..edges import Edges, edges_of
from ..parallel import slices
from ..progress import Progress, Steps
from .border_barrier import crosses_itself
from .borders import border_edges
from .chart import Chart

CURVED = 3e-3  # radians by which the angles around a vertex may differ from a whole turn
LONGER = 1e-3  # of its length: what an edge may gain or lose
CHUNK = 1 << 17  # triangles whose angles are looked at at once
LEVELS = 256  # of triangles, each across an edge from the one before, that are unfolded between two looks at the clock


def unfolded(chart: Chart) -> Steps[np.ndarray | None]:
    """The layout (V, 2) of a chart of even density that has its lengths on the surface and lies nowhere over itself; None where there is
    no such layout."""
    edges = edges_of(chart.triangles, len(chart.vertices))
    yield Progress(0.0, "Unfolding")
    if np.ptp(chart.density) > 0.0 or (yield from _is_curved(chart, edges)):
        return None
    layout = yield from _laid_down(chart, edges)
    there, on_surface = (np.linalg.norm(np.subtract(*places[edges.ends.T]), axis=1) for places in (layout, chart.vertices))
    if not (np.abs(there - on_surface) <= LONGER * on_surface).all():
        return None
    return None if crosses_itself(layout, border_edges(chart.triangles)) else layout


def _is_curved(chart: Chart, edges: Edges) -> Steps[bool]:
    """Whether the angles around a vertex within the chart do not make a whole turn, or a triangle has no area."""
    around = np.zeros(edges.count)
    for rows in slices(len(chart.triangles), CHUNK):
        yield Progress(0.0, "Unfolding")
        corners = chart.vertices[chart.triangles[rows]]
        to_next, to_last = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        sines = np.linalg.norm(np.cross(to_next, to_last), axis=2)
        if (sines == 0.0).any():
            return True
        angles = np.arctan2(sines, np.einsum("tci,tci->tc", to_next, to_last))
        around += np.bincount(chart.triangles[rows].ravel(), angles.ravel(), edges.count)
    return bool((np.abs(around - 2.0 * np.pi)[~edges.on_border] > CURVED).any())


def _laid_down(chart: Chart, edges: Edges) -> Steps[np.ndarray]:
    """Places (V, 2) by unfolding one triangle after the other away from the first; each vertex lies where its first triangle puts it."""
    triangles, beyond = chart.triangles, np.full(3 * len(chart.triangles), -1)
    beyond[edges.inner_sides] = edges.inner_sides[:, ::-1]
    layout, placed, done = (
        np.zeros(shape, kind) for shape, kind in (((edges.count, 2), float), (edges.count, bool), (len(triangles), bool))
    )
    first, second, _ = triangles[0]
    layout[second, 0] = np.linalg.norm(chart.vertices[second] - chart.vertices[first])
    placed[[first, second]] = True
    reached, level = np.array([2]), 0  # sides whose triangle is to be laid down, onto the ends of that side
    while len(reached):
        if level % LEVELS == 0:
            yield Progress(done.mean(), "Unfolding")
        owners, corner = reached // 3, reached % 3
        tips, starts, ends = (triangles[owners, (corner + turn) % 3] for turn in range(3))
        new = ~placed[tips]
        layout[tips[new]] = _tips(chart.vertices, layout, tips[new], starts[new], ends[new])
        placed[tips], done[owners] = True, True
        sides = beyond[(3 * owners[:, None] + np.arange(3)).ravel()]
        sides = sides[sides >= 0]
        sides = sides[~done[sides // 3]]
        reached = sides[np.unique(sides // 3, return_index=True)[1]]
        level += 1
    return layout


def _tips(vertices: np.ndarray, layout: np.ndarray, tips: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Places (N, 2) of vertices `tips`, each to the left of the way from `starts` to `ends`, which lie in the layout already."""
    base, side = vertices[ends] - vertices[starts], vertices[tips] - vertices[starts]
    squares = np.einsum("ni,ni->n", base, base)
    along = np.einsum("ni,ni->n", base, side) / squares
    away = np.linalg.norm(np.cross(base, side), axis=1) / squares
    ways = layout[ends] - layout[starts]
    return layout[starts] + along[:, None] * ways + away[:, None] * (ways[:, ::-1] * [-1.0, 1.0])
