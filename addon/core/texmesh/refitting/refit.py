"""Refit levels: positions and texture coordinates that minimize the deviation from the fine mesh.

Paper, section I: coarse levels for static use need no subset of the fine vertices. Their positions follow by least squares from samples of
the fine mesh at equal texture coordinates; texture coordinates move by Gauss-Newton steps; edges flip where that lowers the cost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...jobs.parallel_steps import run_in_parallel
from ...jobs.progress import Progress, Steps
from ..settings import TexmeshSettings
from ..simplification.levels import TOLERANCE, Simplification, SubsetLevel, extract_level, simplify_by_cost
from ..textured_mesh import TexturedMesh
from .border_curves import BorderCurves, Freedom, find_border_curves, find_freedom, move_uvs
from .correspondence import sample_surface
from .deviation_quadrics import DeviationQuadrics
from .edge_flips import flip_edges
from .edge_splits import split_edges, split_far_edges
from .least_squares import Linearization, compute_moments
from .level_state import LevelState
from .outlier_repair import approach, avoid_folds, flip_outliers, pull_back
from .outliers import FineSurface, measure_distances


@dataclass(frozen=True)
class Tuning:
    """The numbers of the optimization of a level."""

    iterations: int = 12  # Moves of vertices and texture coordinates; large levels get fewer.
    min_iterations: int = 3
    samples_per_triangle: int = 8  # Points of the fine mesh per triangle of the level, to which it is fitted.
    min_samples: int = 16_000
    max_samples: int = 300_000
    max_sampled: int = 1_200_000  # Samples times iterations: most of the error of large levels goes in the first ones.
    triangle_fraction: float = 0.5  # This part of the samples is divided evenly among the fine triangles: small parts need some.
    normal_weight: float = 8.0  # A squared deviation of the surface counts so much more than one of the texture along the surface.
    peak_weight: float = 1.0  # Places count more where the surface deviates most; 0 for the smallest mean.
    peak_scale: float = 4.0  # Squared distances count more if they are large compared with this multiple of their mean.
    max_emphasis: float = 3.0
    max_sample_fraction: float = 5e-3  # One sample counts for at most this part of the cost: a few may jump to another part of a level.
    initial_damping: float = 0.1  # Moves of texture coordinates are damped, less after each step that lowers the cost.
    min_damping: float = 1e-3
    damping_decrease: float = 0.5
    damping_increase: float = 8.0
    tolerance: float = 5e-3  # The fit ends when the cost decreases by a smaller fraction.
    flip_rounds: int = 1  # Rounds of edge flips per iteration.
    split_fraction: float = 0.05  # This part of the triangles of a level is added where the surface deviates most.
    split_parts: int = 2  # Splits are divided into so many iterations, each after the fit has followed the one before.
    late_split_fraction: float = 0.4  # This part of the splits is of the edges that are farthest after the fit.
    late_splits: int = 2  # Rounds of repair in which edges are split.
    repair_rounds: int = 5  # Rounds of flips and moves of outliers.
    simplification_fraction: float = 0.1  # The part of the progress that is the simplification.


TUNING = Tuning()


@dataclass(frozen=True)
class RefitStart:
    """Where the refit of a level starts.

    Attributes:
        target: triangles of the level.
        start: a subset level with fewer triangles, since splits of edges add some.
        full: the subset level with all of them.
    """

    target: int
    start: SubsetLevel
    full: SubsetLevel


def make_starts(
    fine: TexturedMesh,
    source_normals: np.ndarray | None,
    targets: list[int],
    settings: TexmeshSettings,
    moves_vertices: bool = True,
) -> Steps[tuple[Simplification, list[RefitStart]]]:
    """Return the simplification that makes them, and where the refits of levels with `targets` triangles start.

    source_normals, moves_vertices: see `DeviationQuadrics`.
    """
    reduced = [max(round((1.0 - TUNING.split_fraction) * target), 1) for target in targets]
    counts = sorted({*targets, *reduced}, reverse=True)

    def make_cost(mesh: TexturedMesh, _vertices: np.ndarray) -> DeviationQuadrics:
        return DeviationQuadrics(mesh, TUNING.normal_weight, source_normals, moves_vertices)

    result = yield from simplify_by_cost(fine, make_cost, counts, settings)
    levels = dict(zip(counts, result.levels, strict=True))
    return result, [RefitStart(target, levels[count], levels[target]) for target, count in zip(targets, reduced, strict=True)]


def refit_starts(surface: FineSurface, starts: Sequence[RefitStart], iterations: int = TUNING.iterations) -> Steps[list[TexturedMesh]]:
    """Return the levels that `starts` of `make_starts`, or some of them, become: the simplification with all triangles where a refit gets
    no better than its start, or cannot split enough edges. surface: of the fine mesh."""
    fine = surface.mesh
    tasks = [refit(fine, extract_level(fine, start.start), start.target, surface, iterations) for start in starts]
    levels = yield from run_in_parallel(tasks)
    limits = [(1.0 - TOLERANCE) * len(start.full.triangles) for start in starts]
    rows = zip(levels, starts, limits, strict=True)
    return [level if len(level.triangles) >= limit else extract_level(fine, start.full) for level, start, limit in rows]


def refit(
    fine: TexturedMesh, level: TexturedMesh, target: int = 0, surface: FineSurface | None = None, iterations: int = TUNING.iterations
) -> Steps[TexturedMesh]:
    """Return `level` with positions, texture coordinates and edges such that it deviates least from `fine`.

    Vertices on seams and boundaries keep their texture coordinates on the curves of `fine`, equal on both sides of a seam; corners of
    islands keep theirs. No triangle is flipped in UV space. The number of triangles stays, or grows by splits of edges up to `target`.
    Attributes follow their wedges.

    Args:
        level: any simplification of `fine`, in the same space. surface: of `fine`, for several levels; None to make it.
    """
    yield Progress(0.0, "Refitting")
    count = int(np.clip(TUNING.samples_per_triangle * max(len(level.triangles), target), TUNING.min_samples, TUNING.max_samples))
    surface = FineSurface.of(fine) if surface is None else surface
    islands, uv_scale = surface.islands, surface.uv_scale
    samples = sample_surface(fine, islands, count, np.random.default_rng(0), TUNING.triangle_fraction)
    start = state = surface.attach(level, samples, TUNING.normal_weight)
    curves = find_border_curves(fine, islands)
    iterations = min(iterations, max(TUNING.max_sampled // count, TUNING.min_iterations))
    reserve = round(TUNING.late_split_fraction * TUNING.split_fraction * target)
    damping, is_converged = TUNING.initial_damping, False
    for index in range(iterations):
        yield Progress(index / iterations, "Refitting")
        missing, parts = (target - reserve - len(state.mesh.triangles)) // 2, TUNING.split_parts - max(index - 1, 0) // 2
        may_split = missing > 0 and (index % 2 == 1 or iterations <= 2 * TUNING.split_parts)
        if may_split:
            state = split_edges(state, -(-missing // max(min(parts, iterations - 1 - index), 1)))
        if index > 0 and TUNING.peak_weight > 0.0:
            state = emphasize_peaks(state, samples.weights, TUNING.peak_weight)
        state = flip_edges(state, TUNING.flip_rounds)
        moved = _move(state, curves, uv_scale, damping)
        cost, new_cost = sum_costs(state, moved)
        is_better = new_cost < cost
        damping = max(damping * TUNING.damping_decrease, TUNING.min_damping) if is_better else damping * TUNING.damping_increase
        is_converged = is_better and new_cost > (1.0 - TUNING.tolerance) * cost and missing <= 0
        state = moved if is_better else state
        if is_converged:
            break
    state = _repair(state, surface, curves, uv_scale, target)
    cost, new_cost = sum_costs(start, replace(state, samples=samples))
    return state.mesh if new_cost < cost else start.mesh


def _repair(state: LevelState, surface: FineSurface, curves: BorderCurves, uv_scale: float, target: int) -> LevelState:
    """Return the level with its outliers nearer to the fine surface."""
    measured = measure_distances(state, surface)
    for index in range(TUNING.repair_rounds):
        missing = target - len(state.mesh.triangles)
        if missing > 0 and index < TUNING.late_splits:
            missing = min(2 * -(-missing // (2 * (TUNING.late_splits - index))), missing)  # most edges add two triangles
            state = split_far_edges(state, measured, missing, surface, curves)
            state = _move(flip_edges(state, TUNING.flip_rounds), curves, uv_scale, TUNING.min_damping)
            measured = measure_distances(state, surface, measured)
        flipped = flip_outliers(state, surface, measured)
        if flipped is not state:
            state, measured = flipped, measure_distances(flipped, surface, measured)
        moved = approach(state, surface, measured, uv_scale)
        if moved is state and index >= TUNING.late_splits:
            break
        state, measured = moved, measure_distances(moved, surface, measured)
    return pull_back(state, surface, measured)


def _move(state: LevelState, curves: BorderCurves, uv_scale: float, damping: float) -> LevelState:
    """Return the level after a step of positions and texture coordinates, and another of positions."""
    freedom: Freedom = find_freedom(state, uv_scale)
    step = _linearize(state, freedom.directions, damping).solve(uv_scale)
    uvs, fractions = move_uvs(state.mesh, step[:, 3:], freedom, curves)
    moved = state.move(avoid_folds(state, state.mesh.vertices + fractions[:, None] * step[:, :3]), uvs)
    step = _linearize(moved, None, damping).solve(uv_scale)
    return moved.move(avoid_folds(moved, moved.mesh.vertices + step))


def _linearize(state: LevelState, directions: np.ndarray | None, damping: float) -> Linearization:
    """Return the cost around a level, with smaller weights of samples that count too much."""
    limit = TUNING.max_sample_fraction * state.costs.sum()
    if state.costs.max(initial=0.0) > limit:
        factors = np.divide(limit, state.costs, out=np.ones(len(state.costs)), where=state.costs > limit)
        weights = state.samples.weights * factors
        state = replace(state, samples=replace(state.samples, weights=weights))
    return Linearization(state, compute_moments(state), directions, damping)


def sum_costs(state: LevelState, other: LevelState) -> tuple[float, float]:
    """Return the costs of two states with the same samples, each of which counts for at most a small part of the cost of the first."""
    limit = TUNING.max_sample_fraction * state.costs.sum()
    return float(np.minimum(state.costs, limit).sum()), float(np.minimum(other.costs, limit).sum())


def emphasize_peaks(state: LevelState, areas: np.ndarray, peak_weight: float) -> LevelState:
    """Return the level with larger weights of samples that are far from the planes of its triangles. areas: (N,) of the samples."""
    _, normals = state.areas_and_normals
    squares = np.einsum("ni,ni->n", state.residuals, normals[state.found.triangles]) ** 2
    mean = max(float((squares * areas).sum() / areas.sum()), np.finfo(float).tiny)
    emphasis = 1.0 + np.minimum(peak_weight * squares / (TUNING.peak_scale * mean), TUNING.max_emphasis)
    weights = 0.5 * (areas * emphasis + state.samples.weights)  # the mean of two iterations, so that weights do not swing
    return replace(state, samples=replace(state.samples, weights=weights))
