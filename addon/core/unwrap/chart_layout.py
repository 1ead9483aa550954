"""The layout of one chart: from a convex start on a thinned mesh, level by level back to all triangles, down the energy on each."""

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum

import numpy as np

from ..errors import GeometryError
from ..mesh import face_areas_and_normals
from ..progress import Progress, Steps, scaled
from .assembly import Assembly
from .border_barrier import BorderBarrier
from .borders import border_edges, border_loops, filled
from .chart import Chart
from .collapses import Round, thinned
from .insertions import inserted
from .layout_energy import LayoutEnergy
from .newton import minimised
from .polygons import Polygons
from .relaxation import mended
from .rest_shapes import RestShapes, rest_shapes
from .shape_barrier import ShapeBarrier, least_ratios
from .stretch_energy import StretchEnergy
from .tutte import circle, convex_layout, square
from .weights import Weights

COARSEST = 1000  # vertices on which the work begins
GROWTH = 3.0  # times as many vertices from one level to the next
ALONE = 3  # Newton steps of a vertex that has been put back, before all move together
LEVEL_STEPS, LAST_STEPS = 12, 60
LEVEL_TOLERANCE, LAST_TOLERANCE = 1e-3, 1e-4
FIRMER = 10.0  # times as strong the pull on a triangle gets while it is below the bound on its shape
NEARLY = 0.95  # of the ratio that a triangle has, where it could not be brought up to the bound
REACH = 0.3  # of the mean length of the border's edges on the surface: nearer than that, it is pushed away from itself
BULGE = 0.02
ROUNDS, LAST_ROUNDS = 4, 3  # of changing pulls and weights on a level, at most, and to the end on the last one
NEAR, LAST_NEAR = 0.02, 0.05  # of the wanted ratio of densities, in logarithms


class Border(Enum):
    """Where a chart's border goes: wherever its stretch is least, around a circle or around a square."""

    FREE = "free"
    CIRCLE = "circle"
    SQUARE = "square"


def chart_layout(chart: Chart, border: Border, least_ratio: float) -> Steps[np.ndarray]:
    """Layout (V, 2) float64 of `chart`, without flipped triangles and nowhere over itself, as large as suits it best.

    least_ratio: what height over base of every triangle is kept above, where that can be; 0 for no bound.

    Raises:
        GeometryError: when the chart has no border, or no layout to begin with is found.
    """
    yield Progress(0.0, "Thinning")
    count = len(chart.vertices)
    chart, rim = _disk(_normalised(chart))
    work = _Work(chart, border, least_ratio, rim, count)
    coarse, rounds = thinned(chart.vertices, chart.triangles, COARSEST, work.fixed)
    layout = work.begun(coarse)
    layout = yield from scaled(work.settled(layout, coarse, False), 0.05, 0.1)
    for level, start, stop in _levels(rounds, len(np.unique(coarse))):
        for made in level:
            layout = work.with_round(layout, made)
        layout = yield from scaled(work.settled(layout, level[-1].triangles, level[-1] is rounds[0]), start, stop)
    if not rounds or not np.array_equal(rounds[0].triangles, chart.triangles):
        layout = yield from scaled(work.settled(layout, chart.triangles, True), 0.1, 1.0)
    return layout[:count]


def _disk(chart: Chart) -> tuple[Chart, np.ndarray]:
    """The chart with its holes filled, but for the one with the longest rim, its border; and that rim (B,)."""
    loops = border_loops(chart.triangles, chart.vertices)
    if not loops:
        raise GeometryError("A closed surface has no layout in the plane; cut it first.")
    if len(loops) == 1:
        return chart, loops[0]
    vertices, triangles = filled(chart.vertices, chart.triangles, loops[1:])
    density = np.append(chart.density, np.full(len(triangles) - len(chart.triangles), chart.density.min()))
    return Chart(vertices, triangles, density), loops[0]


def _levels(rounds: list[Round], count: int) -> Iterator[tuple[list[Round], float, float]]:
    """Rounds of collapses to be undone together, the last of all first, and the share of the bar that the work on them takes."""
    total = count + sum(len(made.removed) for made in rounds)
    level, begun, done = [], count, 0.1
    for made in reversed(rounds):
        level.append(made)
        count += len(made.removed)
        if count >= GROWTH * begun or made is rounds[0]:
            share = 0.1 + 0.9 * count / total if made is not rounds[0] else 1.0
            yield level, min(done, share), share
            level, begun, done = [], count, share


def _normalised(chart: Chart) -> Chart:
    """The chart scaled to an area of 1."""
    areas, _ = face_areas_and_normals(chart.vertices[chart.triangles])
    total = float(areas.sum())
    scale = 1.0 / np.sqrt(total) if total > 0.0 else 1.0
    return replace(chart, vertices=(chart.vertices - chart.vertices[0]) * scale)


class _Work:
    """What is the same on all levels."""

    def __init__(self, chart: Chart, border: Border, least_ratio: float, rim: np.ndarray, own: int) -> None:
        self._chart, self._border, self._least_ratio = chart, border, least_ratio
        self._weights = Weights(chart, own)
        self.fixed = np.zeros(len(chart.vertices), bool)
        if border is not Border.FREE:
            self.fixed[rim] = True

    def begun(self, triangles: np.ndarray) -> np.ndarray:
        """A first layout of the coarsest mesh."""
        vertices = self._chart.vertices
        [rim] = border_loops(triangles, vertices)
        lengths = np.linalg.norm(np.roll(vertices[rim], -1, axis=0) - vertices[rim], axis=1)
        outline = circle(lengths)
        if self._border is Border.SQUARE and len(lengths) >= 4:
            outline = square(lengths, 0.0)
            side = np.full(len(vertices), -1)
            side[rim] = _sides(outline)
            on_one = (side[triangles] == side[triangles][:, :1]).all(axis=1) & (side[triangles][:, 0] >= 0)
            outline = square(lengths, BULGE) if on_one.any() else outline
        layout = convex_layout(vertices, triangles, rim, outline)
        if not np.isfinite(self._stretch(triangles).value(layout)):
            raise GeometryError(
                "No layout to begin with was found for a part of the surface; look for faces without area and merge doubles."
            )
        return layout

    def with_round(self, layout: np.ndarray, made: Round) -> np.ndarray:
        """The layout with the vertices of a round of collapses put back, where their own triangles are stretched least."""
        layout = inserted(layout, made, self._chart.vertices)
        alone = ~np.isin(made.removed, border_edges(made.triangles)[:, 0])
        owners = made.removed[alone]
        if len(owners):
            polygons = Polygons(layout, owners, made.stars[alone], self._chart.vertices, self._weights.of_vertices())
            layout[owners] = polygons.relaxed(layout[owners], ALONE)
        return self.mended(layout, made.triangles, rest_shapes(self._chart.vertices[made.triangles]))

    def mended(self, layout: np.ndarray, triangles: np.ndarray, shapes: RestShapes) -> np.ndarray:
        """The layout with fewer squeezed triangles, whose rest `shapes` are known."""
        vertices = self._chart.vertices
        stays = self.fixed.copy()
        stays[border_edges(triangles)[:, 0]] = True
        return mended(layout, triangles, vertices, shapes, self._weights.of_vertices(), stays)

    def settled(self, layout: np.ndarray, triangles: np.ndarray, last: bool) -> Steps[np.ndarray]:
        """The layout of least energy of a level's triangles, all above the bound on their shape and as dense as wanted, if that can be."""
        pull = np.ones(len(triangles))
        for number in range(ROUNDS):
            steps = self._lowered(layout, triangles, pull, LEVEL_TOLERANCE, LEVEL_STEPS)
            layout = yield from scaled(steps, 0.1 * number, 0.1 * number + 0.1)
            off = self._weights.adjusted(layout, triangles, NEAR)
            below = least_ratios(layout[triangles]) < self._least_ratio
            if not off and not below.any():
                break
            pull = np.where(below, FIRMER * pull, pull)
        for number in range(LAST_ROUNDS if last else 0):
            share = 0.1 * ROUNDS + 0.2 * number
            layout = yield from scaled(self._lowered(layout, triangles, 0.0 * pull, LAST_TOLERANCE, LAST_STEPS), share, share + 0.2)
            if not self._weights.adjusted(layout, triangles, LAST_NEAR):
                break
        return layout

    def _lowered(self, layout: np.ndarray, triangles: np.ndarray, pull: np.ndarray, tolerance: float, most: int) -> Steps[np.ndarray]:
        """The layout further down the energy. No triangle that is above the bound on its shape goes below it, no other one is lowered; the
        others are pulled up, as strongly as `pull` (T,) says."""
        return (yield from minimised(self._energy(layout, triangles, pull), layout, tolerance, most))

    def _energy(self, layout: np.ndarray, triangles: np.ndarray, pull: np.ndarray) -> LayoutEnergy:
        vertices = self._chart.vertices
        shapes, weights = rest_shapes(vertices[triangles]), self._weights.on(triangles)
        moved = np.zeros(len(vertices), bool)
        moved[triangles] = True
        moved &= ~self.fixed
        barriers = []
        if self._least_ratio > 0.0:
            counts = shapes.areas * np.sqrt(weights)  # half of what stretch comes to where there is none
            ratios = least_ratios(layout[triangles])
            barriers.append(
                ShapeBarrier(triangles, np.arange(len(triangles)), counts, np.minimum(self._least_ratio, NEARLY * ratios), False)
            )
            low = np.flatnonzero((ratios < self._least_ratio) & (pull > 0.0))
            if len(low):
                barriers.append(ShapeBarrier(triangles[low], low, (counts * pull)[low], np.full(len(low), self._least_ratio), True))
        edges = border_edges(triangles)
        free = BorderBarrier(edges, REACH * float(np.linalg.norm(np.subtract(*vertices[edges.T]), axis=1).mean()))
        return LayoutEnergy(
            Assembly(triangles, moved),
            StretchEnergy(triangles, shapes, weights),
            barriers,
            free if self._has_free(edges) else None,
            lambda moved: self.mended(moved, triangles, shapes),
        )

    def _stretch(self, triangles: np.ndarray) -> StretchEnergy:
        return StretchEnergy(triangles, rest_shapes(self._chart.vertices[triangles]), self._weights.on(triangles))

    def _has_free(self, edges: np.ndarray) -> bool:
        return bool((~self.fixed[edges]).any())


def _sides(outline: np.ndarray) -> np.ndarray:
    """Which side of the unit square places (B, 2) lie on, -1 for its corners."""
    (x, y), near = outline.T, 1e-9
    touching = np.stack([y < near, x > 1.0 - near, y > 1.0 - near, x < near])
    return np.where(touching.sum(axis=0) == 1, touching.argmax(axis=0), -1)
