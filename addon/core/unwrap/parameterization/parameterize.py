"""Parameterizes one chart: a Tutte embedding of a decimated mesh, then refined and optimized level by level up to all triangles."""

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from ...errors import GeometryError
from ...geometry.mesh import face_areas_and_normals
from ...geometry.transforms import signed_areas
from ...jobs.chunks import slices
from ...jobs.progress import Progress, Steps, subprogress
from ..cutting.boundaries import boundary_edges, boundary_loops, fill_holes
from ..cutting.chart import Chart
from ..energies.boundary_barrier import self_intersects
from ..energies.newton import minimize
from ..energies.rest_shapes import compute_rest_shapes
from ..energies.shape_barrier import min_height_to_base
from ..energies.stretch_energy import Expansion, StretchEnergy
from ..multiresolution.halfedge_decimation import CollapseBatch, decimate
from ..multiresolution.one_rings import OneRings
from ..multiresolution.relaxation import relax_worst_vertices
from ..multiresolution.subproblems import MAX_DIRECT_VERTICES, MultigridLevel
from ..multiresolution.vertex_splits import split_vertices
from .density_control import DensityWeights
from .tutte import circle_outline, square_outline, tutte_embedding

COARSEST_VERTICES = 2500
LEVEL_GROWTH = 3.0  # Vertices of a level over those of the previous one.
BOUNDARY_BULGES = 0.1, 1e-2, 1e-3, 1e-5, 1e-7, 1e-9  # For split boundary vertices: the next is tried if the boundary intersects itself.
SPLIT_NEWTON_STEPS = 3  # A split vertex makes so many steps on its own, before all move together.
CHUNK_SIZE = 1 << 13  # Vertices that are split at once.
PATCH_SWEEPS = 2  # Sweeps over the patches of a large level.
PENALTY_GROWTH = 10.0  # The penalty on a triangle grows by this factor per round in which it stays below the quality limit.
ACTIVATION_DISTANCE = 0.3  # The boundary barrier sets in at this fraction of the mean boundary edge length on the surface.
SQUARE_BULGE = 0.02  # Sagitta of the sides of the initial square, where a triangle with all corners on one side would have no area.
ROUNDS, FINAL_ROUNDS = 4, 3  # Maximum rounds of adapting penalties and weights per level, and at the end of the last level.
# When balanced, the symmetry is this multiple of the excess of symmetric Dirichlet energy, but at most `MAX_SYMMETRY`. In any chart
# the lower stretch then costs one or two percent of that energy.
SYMMETRY_PER_EXCESS, MAX_SYMMETRY = 0.5, 0.25
DENSITY_TOLERANCE, FINAL_DENSITY_TOLERANCE = 0.02, 0.05  # Differences of the logarithms of density ratios.


class Schedule(NamedTuple):
    """When a minimization ends: `tolerance` and `max_steps` of `newton.minimize`. is_intermediate: a finer level follows."""

    tolerance: float
    max_steps: int
    is_intermediate: bool = False


COARSEST = Schedule(3e-4, 30)
INTERMEDIATE = Schedule(3e-3, 4, is_intermediate=True)
FINAL = Schedule(1e-3, 30)
SINGLE_LEVEL = Schedule(3e-4, 100)
ROUGH = Schedule(3e-2, 15)  # Comes first on the coarsest level, to see how distorted a chart is, and where.
AFTER_CHANGE = Schedule(1e-3, 12)  # After a change of penalties or weights.

FAILURE = "Part of the mesh could not be unwrapped. Remove zero-area faces, use Merge by Distance, or set Islands to Atlas."


class DistortionError(GeometryError):
    """A chart is too distorted in one piece. excess: of symmetric Dirichlet energy, as a fraction of that of an isometry."""

    def __init__(self, message: str, excess: float) -> None:
        super().__init__(message)
        self.excess = excess


class Boundary(Enum):
    """Shape of a chart's boundary: free, where stretch is minimal, or fixed to a circle or a square."""

    FREE = "free"
    CIRCLE = "circle"
    SQUARE = "square"


class Balance(Enum):
    """Balance of compression and expansion in the map: little stretch without needles, symmetric Dirichlet energy, or L2 stretch alone."""

    BALANCED = "balanced"
    SYMMETRIC = "symmetric"
    STRETCH = "stretch"


# Of the coarsest level. When balanced, the symmetry of all others follows from the distortion of the previous level.
EXPANSIONS = {Balance.BALANCED: Expansion(0.2, 0.01), Balance.SYMMETRIC: Expansion(1.0, 0.0), Balance.STRETCH: Expansion(0.0, 0.0)}


def parameterize(
    chart: Chart,
    boundary: Boundary,
    min_quality: float,
    balance: Balance = Balance.BALANCED,
    max_excess: float = np.inf,
    is_rough: bool = False,
) -> Steps[np.ndarray]:
    """Return uv (V, 2) float64 of `chart`, without flipped triangles or overlaps, at the scale of minimum energy.

    Args:
        chart: a disk, possibly with holes.
        boundary: shape of the boundary.
        min_quality: lower limit of the height-to-base ratio of triangles, met where possible; 0 for none.
        balance: of compression and expansion.
        max_excess: limit of the excess of symmetric Dirichlet energy.
        is_rough: stop as soon as it is clear where the chart is stretched; the map may overlap itself.

    Raises:
        DistortionError: the coarsest mesh exceeds `max_excess`.
        GeometryError: the chart has no boundary, or no valid uv was found.
    """
    yield Progress(0.0, "Decimating")
    disk = _fill_to_disk(_normalize_area(chart))
    chart = disk.chart
    yield Progress(0.0, "Decimating")
    parameterizer = _Parameterizer(disk, _Requirements(boundary, min_quality, balance, may_overlap=is_rough))
    coarse, batches = yield from subprogress(
        decimate(chart.vertices, chart.triangles, COARSEST_VERTICES, parameterizer.is_fixed), 0.0, 0.05
    )
    uv = yield from subprogress(parameterizer.optimize_level(parameterizer.initial_uv(coarse), coarse, ROUGH, False), 0.05, 0.05)
    if parameterizer.excess > max_excess:
        raise DistortionError(FAILURE, parameterizer.excess)
    if not is_rough:
        steps = parameterizer.optimize_level(uv, coarse, COARSEST if batches else SINGLE_LEVEL, not batches)
        uv = yield from subprogress(steps, 0.05, 0.1 if batches else 1.0)
    for level, start, stop in _group_into_levels(batches, len(np.unique(coarse))):
        for batch in level:
            uv = yield from subprogress(parameterizer.refine(uv, batch), start, start)
        uv = yield from subprogress(parameterizer.optimize_level(uv, level[-1].triangles, INTERMEDIATE, not batches), start, stop)
    yield Progress(1.0, "Unwrapping")
    if not signed_areas(uv[chart.triangles]).min() > 0.0:
        raise GeometryError(FAILURE)
    return uv[: disk.surface_count]


def _fill_to_disk(chart: Chart) -> "_FilledDisk":
    """Return the chart with all holes filled except for the longest boundary loop."""
    loops = boundary_loops(chart.triangles, chart.vertices)
    if not loops:
        raise GeometryError("A closed surface cannot be unwrapped; cut it first.")
    if len(loops) == 1:
        return _FilledDisk(chart, loops[0], len(chart.vertices))
    vertices, triangles = fill_holes(chart.vertices, chart.triangles, loops[1:])
    density = np.append(chart.density, np.full(len(triangles) - len(chart.triangles), chart.density.min()))
    return _FilledDisk(Chart(vertices, triangles, density), loops[0], len(chart.vertices))


def _group_into_levels(batches: list[CollapseBatch], count: int) -> Iterator[tuple[list[CollapseBatch], float, float]]:
    """Yield the batches of collapses to undo per level, in reverse order, with the progress at the start and end of the level.

    Batches are removed from `batches`, which releases their memory. count: number of vertices of the coarsest level.
    """
    total = count + sum(len(batch.removed) for batch in batches)
    level, level_start_count, start = [], count, 0.1
    while batches:
        level.append(batches.pop())
        count += len(level[-1].removed)
        if count >= LEVEL_GROWTH * level_start_count or not batches:
            stop = 0.1 + 0.9 * count / total if batches else 1.0
            yield level, min(start, stop), stop
            level, level_start_count, start = [], count, stop


def _normalize_area(chart: Chart) -> Chart:
    """Scale a chart to an area of 1 and move its first vertex to the origin."""
    areas, _ = face_areas_and_normals(chart.vertices[chart.triangles])
    total = float(areas.sum())
    scale = 1.0 / np.sqrt(total) if total > 0.0 else 1.0
    return replace(chart, vertices=(chart.vertices - chart.vertices[0]) * scale)


class _FilledDisk(NamedTuple):
    """A chart with all holes filled except for its longest boundary loop, (B,) vertices. Only its first vertices are surface."""

    chart: Chart
    boundary_loop: np.ndarray
    surface_count: int


class _Requirements(NamedTuple):
    """What a map has to fulfill: see `parameterize`. may_overlap: whether only the shapes of triangles count."""

    boundary: Boundary
    min_quality: float
    balance: Balance
    may_overlap: bool


class _Parameterizer:
    """The parts of a parameterization that all levels share.

    is_fixed: (V,) bool, vertices on a fixed boundary. excess: of symmetric Dirichlet energy, on the level that was optimized last.
    """

    def __init__(self, disk: _FilledDisk, requirements: _Requirements) -> None:
        chart, self._requirements = disk.chart, requirements
        self._chart, self._expansion, self.excess = chart, EXPANSIONS[requirements.balance], 0.0
        self._weights = DensityWeights(chart, disk.surface_count)
        self.is_fixed = np.zeros(len(chart.vertices), bool)
        if requirements.boundary is not Boundary.FREE:
            self.is_fixed[disk.boundary_loop] = True

    def initial_uv(self, triangles: np.ndarray) -> np.ndarray:
        """Return the Tutte embedding (V, 2) of the coarsest mesh."""
        vertices = self._chart.vertices
        [loop] = boundary_loops(triangles, vertices)
        lengths = np.linalg.norm(np.roll(vertices[loop], -1, axis=0) - vertices[loop], axis=1)
        outline = circle_outline(lengths)
        if self._requirements.boundary is Boundary.SQUARE and len(lengths) >= 4:
            outline = square_outline(lengths, 0.0)
            side = np.full(len(vertices), -1)
            side[loop] = _square_sides(outline)
            is_flat = (side[triangles] == side[triangles][:, :1]).all(axis=1) & (side[triangles][:, 0] >= 0)
            outline = square_outline(lengths, SQUARE_BULGE) if is_flat.any() else outline
        uv = tutte_embedding(vertices, triangles, loop, outline)
        if uv is None:
            raise GeometryError(FAILURE)
        return uv

    def refine(self, uv: np.ndarray, batch: CollapseBatch) -> Steps[np.ndarray]:
        """Return uv with the vertices of a batch of collapses split off, each at the position of minimum stretch of its triangles."""
        level = yield from self._build_level(batch.triangles)
        coarse_uv, uv = uv, (yield from self._split_vertices(uv, batch, None))
        for bulge in BOUNDARY_BULGES if len(level.boundary) else ():
            if not self_intersects(uv, level.boundary):
                break
            uv = yield from self._split_vertices(coarse_uv, batch, bulge)
        is_boundary = np.zeros(len(uv), bool)
        is_boundary[level.boundary] = True
        is_interior = ~is_boundary[batch.removed]
        centers, links = batch.removed[is_interior], batch.links[is_interior]
        for rows in slices(len(centers), CHUNK_SIZE):
            yield Progress(0.0, "Refining")
            rings = OneRings(uv, centers[rows], links[rows], self._chart.vertices, level.vertex_weights, self._expansion.symmetry)
            uv[centers[rows]] = rings.relax(uv[centers[rows]], SPLIT_NEWTON_STEPS)
        yield Progress(0.0, "Refining")
        is_fixed = is_boundary | self.is_fixed
        return relax_worst_vertices(
            uv, batch.triangles, self._chart.vertices, level.shapes, level.vertex_weights, is_fixed, self._expansion.symmetry
        )

    def _split_vertices(self, uv: np.ndarray, batch: CollapseBatch, bulge: float | None) -> Steps[np.ndarray]:
        for rows in slices(len(batch.removed), CHUNK_SIZE):
            yield Progress(0.0, "Refining")
            uv = split_vertices(uv, batch.subset(rows), self._chart.vertices, bulge)
        return uv

    def _build_level(self, triangles: np.ndarray) -> Steps[MultigridLevel]:
        progress = Progress(0.0, "Unwrapping")
        yield progress
        vertices, boundary = self._chart.vertices, boundary_edges(triangles)
        yield progress
        shapes = compute_rest_shapes(vertices[triangles])
        yield progress
        is_used = np.zeros(len(vertices), bool)
        is_used[triangles] = True
        return MultigridLevel(
            vertices=vertices,
            triangles=triangles,
            shapes=shapes,
            weights=self._weights.for_triangles(triangles),
            vertex_weights=self._weights.for_vertices(),
            boundary=boundary[:0] if self._requirements.may_overlap or self.is_fixed[boundary].all() else boundary,
            is_free=is_used & ~self.is_fixed,
            activation_distance=ACTIVATION_DISTANCE * float(np.linalg.norm(np.subtract(*vertices[boundary.T]), axis=1).mean()),
            expansion=self._expansion,
        )

    def optimize_level(self, uv: np.ndarray, triangles: np.ndarray, schedule: Schedule, is_last: bool) -> Steps[np.ndarray]:
        """Return uv of minimum energy of a level's triangles, with all triangles above the quality limit and the requested densities, where
        possible."""
        penalties, is_changed = np.ones(len(triangles)), np.ones(len(triangles), bool)
        level = yield from self._build_level(triangles)
        skip_rounds = is_last and schedule.is_intermediate and self._is_stretch_only
        for index in range(0 if skip_rounds else ROUNDS):
            current = AFTER_CHANGE if index else schedule
            start = 0.1 * index
            uv = yield from subprogress(self._minimize(uv, level, penalties, is_changed, current), start, start + 0.1)
            exponent_changed = self._weights.adapt_exponent(uv, triangles, FINAL_DENSITY_TOLERANCE if is_last else DENSITY_TOLERANCE)
            is_poor = min_height_to_base(uv[triangles]) < self._requirements.min_quality
            if not exponent_changed and not is_poor.any():
                break
            level = (yield from subprogress(self._build_level(triangles), start, start)) if exponent_changed else level
            penalties, is_changed = np.where(is_poor, PENALTY_GROWTH * penalties, penalties), is_poor | exponent_changed
        self.excess = StretchEnergy(triangles, level.shapes, level.weights, self._expansion).distortion_excess(uv)
        if self._requirements.balance is Balance.BALANCED:
            self._expansion = self._expansion._replace(symmetry=min(SYMMETRY_PER_EXCESS * self.excess, MAX_SYMMETRY))
        has_final_rounds = is_last and (schedule.is_intermediate or not self._is_stretch_only)
        for index in range(FINAL_ROUNDS if has_final_rounds else 0):
            start = 0.1 * ROUNDS + 0.2 * index
            uv = yield from subprogress(self._minimize(uv, level, 0.0 * penalties, penalties > 0.0, FINAL), start, start + 0.2)
            if not self._weights.adapt_exponent(uv, triangles, FINAL_DENSITY_TOLERANCE):
                break
            level = yield from subprogress(self._build_level(triangles), start, start)
        return uv

    @property
    def _is_stretch_only(self) -> bool:
        """Whether the energy is stretch alone, without density or quality requirements."""
        return self._weights.is_uniform and self._requirements.min_quality == 0.0

    def _minimize(
        self, uv: np.ndarray, level: MultigridLevel, penalties: np.ndarray, is_changed: np.ndarray, schedule: Schedule
    ) -> Steps[np.ndarray]:
        """Return uv of lower energy, with `penalties` (T,) on triangles below the quality limit.

        is_changed: (T,) bool, triangles whose energy has changed; without any, nothing is done.
        """
        uv = uv.copy()
        is_divided = not schedule.is_intermediate and int(level.is_free.sum()) > MAX_DIRECT_VERTICES
        sweeps = PATCH_SWEEPS if is_divided else 1
        for sweep in range(sweeps):
            for done, subproblem in level.subproblems(uv, sweep, is_changed):
                yield Progress((sweep + done) / sweeps, "Unwrapping")
                if subproblem is None:
                    continue
                start_uv = uv[subproblem.vertex_indices]
                energy = subproblem.energy(start_uv, self._requirements.min_quality, penalties[subproblem.triangle_indices])
                steps = minimize(energy, start_uv, schedule.tolerance, schedule.max_steps)
                uv[subproblem.vertex_indices] = yield from subprogress(steps, (sweep + done) / sweeps, (sweep + done + 0.01) / sweeps)
        return uv


def _square_sides(outline: np.ndarray) -> np.ndarray:
    """Return the side (B,) of the unit square that each point of `outline` (B, 2) is on, -1 for its corners."""
    (x, y), tolerance = outline.T, 1e-9
    is_on_side = np.stack([y < tolerance, x > 1.0 - tolerance, y > 1.0 - tolerance, x < tolerance])
    return np.where(is_on_side.sum(axis=0) == 1, is_on_side.argmax(axis=0), -1)
