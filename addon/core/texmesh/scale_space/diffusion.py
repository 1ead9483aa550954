"""Implicit heat diffusion of signals on a surface over geometrically growing times, and the Laplacian of the signals.

A step of length h solves (M + h L) u' = M u with masses M and Laplacian L. Its Laplacian is (u - u') / h, exact for the discrete operator,
so nothing is differentiated. Small times are computed on the mesh; two scales that follow each other use the same step length and so one
factorization. Large times are computed on coarse levels. What comes back to a finer level is smoothed there by one step with the
factorization that this level used last, and the time on the coarse level is shorter by that step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ...jobs.progress import Progress, Steps
from .coarsening import Level
from .scale_map import SCALES

GROWTHS = [Fraction(*pair) for pair in [(6, 5), (5, 4), (4, 3), (7, 5), (3, 2), (8, 5), (5, 3), (7, 4), (2, 1), (5, 2), (3, 1), (4, 1)]]
MIN_STEPS, COARSE_STEPS = 2, 3  # per scale, on the mesh and on coarse levels
SIGMA_PER_RADIUS = 4.0  # from this standard deviation on, relative to its radius, a level is fine enough
SEARCH_SIZE = 2500  # degrees of freedom on which the largest scale is searched
SEARCH_GROWTH = 1.15  # of the standard deviation between two steps of the search


@dataclass(frozen=True)
class _Solver:
    """The factorization for steps of length `step` on a level."""

    factor: object
    level: Level
    step: float

    def advance(self, integrals: np.ndarray) -> np.ndarray:
        """Return the values (n, S) after a step from values with `integrals` (n, S): masses times values."""
        return self.factor.solve(integrals)


def _build_solver(level: Level, step: float) -> _Solver:
    system = (level.mass + step * level.laplacian).tocsc()
    factor = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return _Solver(factor, level, step)


def choose_times(first_sigma: float, last_sigma: float) -> tuple[np.ndarray, Fraction]:
    """Return the times (20,) of scales 1 to 20, and the factor by which they grow: the smallest for which scale 1 has at most
    `first_sigma`. The standard deviation at time t is sqrt(2 t); that of scale 20 is `last_sigma`."""
    needed = (last_sigma / first_sigma) ** (2.0 / (SCALES - 2))
    growth = next((growth for growth in GROWTHS if growth >= needed), GROWTHS[-1])
    return 0.5 * last_sigma**2 * float(growth) ** np.arange(2.0 - SCALES, 1.0), growth


def diffuse(levels: Sequence[Level], integrals: np.ndarray, times: np.ndarray, growth: Fraction) -> Steps[tuple[np.ndarray, np.ndarray]]:
    """Diffuse signals; return their negative Laplacians (20, V, S) float32 at `times` (20,), and the ranges (20, S) of the signals.

    Ranges are the largest of a connected component. On coarse levels they are those of the degrees of freedom.

    integrals: (V, S) of the signals around each vertex. growth: the factor by which the times grow.
    """
    laplacians, ranges = np.empty((len(times), *integrals.shape), np.float32), np.empty((len(times), integrals.shape[1]))
    finer: list[_Solver] = []
    solver, elapsed = None, 0.0
    components = _label_components(levels[0])
    for scale, time in enumerate(times):
        yield Progress(scale / len(times), f"Diffusing, scale {scale + 1} of {len(times)}")
        if solver is not None and len(finer) + 1 < len(levels):
            coarser = levels[len(finer) + 1]
            if np.sqrt(2.0 * times[scale - 1]) >= SIGMA_PER_RADIUS * coarser.radius:
                finer.append(solver)
                integrals, solver = coarser.prolongation.T @ integrals, None
                components = _label_components(coarser)
        level = levels[len(finer)]
        duration = time - sum(each.step for each in finer) - elapsed
        count = COARSE_STEPS if finer else _count_steps(scale, growth)
        if solver is None or abs(solver.step - duration / count) > 1e-9 * solver.step:
            solver = _build_solver(level, duration / count)
        for _ in range(count - 1):
            values = solver.advance(integrals)
            integrals = level.mass @ values
        before, values = values, solver.advance(integrals)
        integrals = level.mass @ values
        elapsed += duration
        ranges[scale] = _find_ranges(values, components)
        laplacians[scale] = _bring_to_mesh((before - values) / solver.step, levels, finer)
    return laplacians, ranges


def _count_steps(scale: int, growth: Fraction) -> int:
    """Return the number of steps to index `scale` of the times: each two from the second on have steps of equal length."""
    base = growth.denominator * -(-MIN_STEPS // growth.denominator)
    return MIN_STEPS if scale == 0 else base if scale % 2 else int(base * growth)


def _bring_to_mesh(values: np.ndarray, levels: Sequence[Level], finer: Sequence[_Solver]) -> np.ndarray:
    """Return `values` (n, S) of the level after `finer` on the mesh, (V, S), smoothed on each level by its solver."""
    for index in range(len(finer) - 1, -1, -1):
        values = finer[index].advance(levels[index].mass @ (levels[index + 1].prolongation @ values))
    return values


def search_last_sigma(
    levels: Sequence[Level], integrals: np.ndarray, weights: np.ndarray, convergence: float, limit: float
) -> tuple[float, np.ndarray]:
    """Return the standard deviation at which the signals have converged, at most `limit`, and the largest ranges (S,).

    The range of the first signal, curvature, is multiplied by the standard deviation: the angle by which the surface turns over that
    length. A signal has converged to the degree of its range relative to its largest; `weights` (S,) are those of the mean.

    integrals: (V, S) of the signals around each vertex. convergence: the mean at which to stop, below 1.
    """
    index = next((index for index, level in enumerate(levels) if len(level.positions) <= SEARCH_SIZE), len(levels) - 1)
    for level in levels[1 : index + 1]:
        integrals = level.prolongation.T @ integrals
    level = levels[index]
    components = _label_components(level)
    sigma, largest, time = max(level.radius, 1e-2 * limit), np.zeros(len(weights)), 0.0
    while True:
        solver = _build_solver(level, (0.5 * sigma**2 - time) / MIN_STEPS)
        for _ in range(MIN_STEPS):
            values = solver.advance(integrals)
            integrals = level.mass @ values
        time = 0.5 * sigma**2
        ranges = _find_ranges(values, components) * np.array([sigma] + [1.0] * (len(weights) - 1))
        largest = np.maximum(largest, ranges)
        relative = float(weights @ (ranges / np.where(largest > 0.0, largest, 1.0)))
        if relative < convergence * weights.sum() or sigma * SEARCH_GROWTH > limit:
            return sigma, largest
        sigma *= SEARCH_GROWTH


def _label_components(level: Level) -> np.ndarray:
    """Return the connected component (n,) of each degree of freedom."""
    return connected_components(level.laplacian, directed=False)[1]


def _find_ranges(values: np.ndarray, components: np.ndarray) -> np.ndarray:
    """Return the largest range (S,) of `values` (n, S) within one of the connected `components` (n,)."""
    order = np.argsort(components, kind="stable")
    starts = np.flatnonzero(np.diff(components[order], prepend=-1))
    return (np.maximum.reduceat(values[order], starts) - np.minimum.reduceat(values[order], starts)).max(axis=0)
