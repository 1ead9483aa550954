"""The layout of one chart: from a convex start on a thinned mesh, level by level back to all triangles, down the energy on each."""

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum

import numpy as np

from ..errors import GeometryError
from ..mesh import face_areas_and_normals
from ..parallel import slices
from ..progress import Progress, Steps, scaled
from .border_barrier import crosses_itself
from .borders import border_edges, border_loops, filled
from .chart import Chart
from .collapses import Round, thinned
from .insertions import inserted
from .newton import minimised
from .parts import DIRECT, Level
from .plane import signed_areas
from .polygons import Polygons
from .relaxation import mended
from .rest_shapes import rest_shapes
from .shape_barrier import least_ratios
from .tutte import circle, convex_layout, square
from .weights import Weights

COARSEST = 2500  # vertices on which the work begins
GROWTH = 3.0  # times as many vertices from one level to the next
BULGES = 0.1, 1e-2, 1e-3, 1e-5, 1e-7, 1e-9  # of the border where a vertex is put back, each tried where the one before comes upon something
ALONE = 3  # Newton steps of a vertex that has been put back, before all move together
FIRST, BETWEEN, LAST = (3e-4, 30), (3e-3, 4), (1e-3, 30)  # tolerance and steps on the coarsest level, on those after it, and at the end
ONLY = 3e-4, 100  # where there is one level alone
ROUGH = 1e-2, 30  # instead of FIRST, to see where a chart is stretched
ROUND = 1e-3, 12  # and after a change of pulls or weights
CHUNK = 1 << 13  # vertices that are put back at once
SWEEPS = 2  # over the patches of a level
FIRMER = 10.0  # times as strong the pull on a triangle gets while it is below the bound on its shape
REACH = 0.3  # of the mean length of the border's edges on the surface: nearer than that, it is pushed away from itself
BULGE = 0.02
ROUNDS, LAST_ROUNDS = 4, 3  # of changing pulls and weights on a level, at most, and to the end on the last one
NEAR, LAST_NEAR = 0.02, 0.05  # of the wanted ratio of densities, in logarithms


NO_LAYOUT = "No layout was found for a part of the surface; look for faces without area and merge doubles, or lay it out as an atlas."


class Border(Enum):
    """Where a chart's border goes: wherever its stretch is least, around a circle or around a square."""

    FREE = "free"
    CIRCLE = "circle"
    SQUARE = "square"


def chart_layout(chart: Chart, border: Border, least_ratio: float, rough: bool = False) -> Steps[np.ndarray]:
    """Layout (V, 2) float64 of `chart`, without flipped triangles and nowhere over itself, as large as suits it best.

    least_ratio: what height over base of every triangle is kept above, where that can be; 0 for no bound. rough: ends as soon as it shows
    where the chart is stretched.

    Raises:
        GeometryError: when the chart has no border, or no layout is found.
    """
    yield Progress(0.0, "Thinning")
    count = len(chart.vertices)
    chart, rim = _disk(_normalised(chart))
    yield Progress(0.0, "Thinning")
    work = _Work(chart, border, least_ratio, rim, count)
    coarse, rounds = yield from scaled(thinned(chart.vertices, chart.triangles, COARSEST, work.fixed), 0.0, 0.05)
    layout = work.begun(coarse)
    effort = ROUGH if rough else FIRST if rounds else ONLY
    layout = yield from scaled(work.settled(layout, coarse, effort, not rounds), 0.05, 0.1 if rounds else 1.0)
    for level, start, stop in _levels(rounds, len(np.unique(coarse))):
        for made in level:
            layout = yield from scaled(work.with_round(layout, made), start, start)
        layout = yield from scaled(work.settled(layout, level[-1].triangles, BETWEEN, not rounds), start, stop)
    yield Progress(1.0, "Unwrapping")
    if not signed_areas(layout[chart.triangles]).min() > 0.0:
        raise GeometryError(NO_LAYOUT)
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
    """Rounds of collapses to be undone together, the last of all first, and the share of the bar that the work on them takes.

    They are taken out of `rounds`, so that what is done takes no memory.
    """
    total = count + sum(len(made.removed) for made in rounds)
    level, begun, done = [], count, 0.1
    while rounds:
        level.append(rounds.pop())
        count += len(level[-1].removed)
        if count >= GROWTH * begun or not rounds:
            share = 0.1 + 0.9 * count / total if rounds else 1.0
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
        if layout is None:
            raise GeometryError(NO_LAYOUT)
        return layout

    def with_round(self, layout: np.ndarray, made: Round) -> Steps[np.ndarray]:
        """The layout with the vertices of a round of collapses put back, where their own triangles are stretched least."""
        level = yield from self.level(made.triangles)
        before, layout = layout, (yield from self._put_back(layout, made, None))
        for bulge in BULGES if len(level.border) else ():
            if not crosses_itself(layout, level.border):
                break
            layout = yield from self._put_back(before, made, bulge)
        rim = np.zeros(len(layout), bool)
        rim[level.border] = True
        alone = ~rim[made.removed]
        owners, stars = made.removed[alone], made.stars[alone]
        for rows in slices(len(owners), CHUNK):
            yield Progress(0.0, "Putting vertices back")
            polygons = Polygons(layout, owners[rows], stars[rows], self._chart.vertices, level.vertex_weights)
            layout[owners[rows]] = polygons.relaxed(layout[owners[rows]], ALONE)
        yield Progress(0.0, "Putting vertices back")
        return mended(layout, made.triangles, self._chart.vertices, level.shapes, level.vertex_weights, rim | self.fixed)

    def _put_back(self, layout: np.ndarray, made: Round, bulge: float | None) -> Steps[np.ndarray]:
        for rows in slices(len(made.removed), CHUNK):
            yield Progress(0.0, "Putting vertices back")
            layout = inserted(layout, made.some(rows), self._chart.vertices, bulge)
        return layout

    def level(self, triangles: np.ndarray) -> Steps[Level]:
        """What the energies of a level's triangles need."""
        begun = Progress(0.0, "Unwrapping")
        yield begun
        vertices, border = self._chart.vertices, border_edges(triangles)
        yield begun
        shapes = rest_shapes(vertices[triangles])
        yield begun
        moved = np.zeros(len(vertices), bool)
        moved[triangles] = True
        return Level(
            vertices=vertices,
            triangles=triangles,
            shapes=shapes,
            weights=self._weights.on(triangles),
            vertex_weights=self._weights.of_vertices(),
            border=border if (~self.fixed[border]).any() else border[:0],
            moved=moved & ~self.fixed,
            reach=REACH * float(np.linalg.norm(np.subtract(*vertices[border.T]), axis=1).mean()),
        )

    def settled(self, layout: np.ndarray, triangles: np.ndarray, effort: tuple[float, int], last: bool) -> Steps[np.ndarray]:
        """The layout of least energy of a level's triangles, all above the bound on their shape and as dense as wanted, if that can be.

        effort: at first, BETWEEN where a coarser level went before.
        """
        pull, changed = np.ones(len(triangles)), np.ones(len(triangles), bool)
        level = yield from self.level(triangles)
        for number in range(0 if last and effort is BETWEEN and self._unbound else ROUNDS):
            now = ROUND if number else effort
            layout = yield from scaled(self._lowered(layout, level, pull, changed, now), 0.1 * number, 0.1 * number + 0.1)
            off = self._weights.adjusted(layout, triangles, LAST_NEAR if last else NEAR)
            below = least_ratios(layout[triangles]) < self._least_ratio
            if not off and not below.any():
                break
            level = (yield from scaled(self.level(triangles), 0.1 * number, 0.1 * number)) if off else level
            pull, changed = np.where(below, FIRMER * pull, pull), below | off
        for number in range(LAST_ROUNDS if last and (effort is BETWEEN or not self._unbound) else 0):
            share = 0.1 * ROUNDS + 0.2 * number
            layout = yield from scaled(self._lowered(layout, level, 0.0 * pull, pull > 0.0, LAST), share, share + 0.2)
            if not self._weights.adjusted(layout, triangles, LAST_NEAR):
                break
            level = yield from scaled(self.level(triangles), share, share)
        return layout

    @property
    def _unbound(self) -> bool:
        """Whether nothing but stretch counts."""
        return self._weights.even and self._least_ratio == 0.0

    def _lowered(
        self, layout: np.ndarray, level: Level, pull: np.ndarray, changed: np.ndarray, effort: tuple[float, int]
    ) -> Steps[np.ndarray]:
        """The layout further down the energy, with a `pull` (T,) on triangles that are below the bound on their shape.

        changed: (T,) bool, for which triangles the energy is another one than it was; where it is for none, nothing is done.
        """
        layout = layout.copy()
        sweeps = SWEEPS if effort is not BETWEEN and int(level.moved.sum()) > DIRECT else 1
        for sweep in range(sweeps):
            for done, part in level.parts(layout, sweep, changed):
                yield Progress((sweep + done) / sweeps, "Unwrapping")
                if part is None:
                    continue
                own = layout[part.numbers]
                steps = minimised(part.energy(own, self._least_ratio, pull[part.which]), own, *effort)
                layout[part.numbers] = yield from scaled(steps, (sweep + done) / sweeps, (sweep + done + 0.01) / sweeps)
        return layout


def _sides(outline: np.ndarray) -> np.ndarray:
    """Which side of the unit square places (B, 2) lie on, -1 for its corners."""
    (x, y), near = outline.T, 1e-9
    touching = np.stack([y < near, x > 1.0 - near, y > 1.0 - near, x < near])
    return np.where(touching.sum(axis=0) == 1, touching.argmax(axis=0), -1)
