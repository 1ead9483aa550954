"""Implicit heat diffusion of signals on a surface over geometrically growing times, and the Laplacian of the signals.

A step of length h solves (M + h L) u' = M u with masses M and Laplacian L. Its Laplacian is (u - u') / h, exact for the discrete operator,
so nothing is differentiated. Small times are computed on the mesh; two scales that follow each other use the same step length and so one
factorization. Large times are computed on coarse levels. What comes back to a finer level is smoothed there by one step with the
factorization that this level used last, and the time on the coarse level is shorter by that step.

Coarse levels are made by smoothed aggregation. Vertices that are close together become an aggregate, around roots that are a maximal
independent set at distance two (Bell, Dalton and Olson, "Exposing Fine-Grained Parallelism in Algebraic Multigrid Methods", 2012).
Functions on aggregates are smoothed, and Laplacian and masses are projected onto them (Galerkin). Where vertices are farther apart than the
radius of a level they remain, so that the coarse functions are about equally wide on irregular meshes. Such functions have a larger
gradient than those that they approximate. The Laplacian is divided by the factor by which this changes the energy of smooth functions
(overcorrection, as in Braess, "Towards Algebraic Multigrid for Elliptic Problems of Second Order", 1995).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ...arrays import TINY
from ...errors import GeometryError
from ...jobs.progress import Progress, Steps
from .features import SCALES

GROWTHS = [Fraction(*pair) for pair in [(6, 5), (5, 4), (4, 3), (7, 5), (3, 2), (8, 5), (5, 3), (7, 4), (2, 1), (5, 2), (3, 1), (4, 1)]]
UNSOLVABLE = (
    "The mesh cannot be analyzed: most of its triangles are tiny compared to its size; delete vertices that are far away from the others."
)
MIN_STEPS, COARSE_STEPS = 2, 3  # per scale, on the mesh and on coarse levels


@dataclass(frozen=True)
class Tuning:
    """Numbers of the method."""

    sigma_per_radius: float = 4.0  # From this standard deviation on, relative to its radius, a level is fine enough.
    search_size: int = 2500  # Degrees of freedom on which the largest scale is searched.
    search_growth: float = 1.15  # Factor of the standard deviation between two steps of the search.
    radius_growth: float = 2.5  # Between two levels: that of the distance between roots.
    min_size: int = 400  # Degrees of freedom below which a level is not coarsened.
    max_levels: int = 12
    min_reduction: float = 0.9  # Levels with more than this fraction of the degrees of freedom are left out.
    smoothing: float = 2.0 / 3.0  # Damping of the Jacobi steps that smooth functions on aggregates.
    min_energy: float = 0.1  # With a smaller energy of coarse coordinates, relative to fine ones, most components have become points.
    mass_digits: float = 1e5  # Mass relative to the mean is rounded to this for an order that does not depend on that of the vertices.


TUNING = Tuning()

SMOOTHING_STEPS, COORDINATE_STEPS = 2, 12  # Steps of functions on aggregates, and of the coordinates whose energy is compared.


@dataclass(frozen=True)
class Level:
    """Functions with n degrees of freedom on a mesh.

    Attributes:
        laplacian, mass: (n, n).
        positions: (n, 3), of the degrees of freedom.
        radius: distance within which vertices were aggregated, 0 for the mesh itself.
        prolongation: (n of the finer level, n), None for the mesh itself.
    """

    laplacian: sparse.csc_array
    mass: sparse.csc_array
    positions: np.ndarray
    radius: float
    prolongation: sparse.csr_array | None


def build_levels(laplacian: sparse.csc_array, masses: np.ndarray, positions: np.ndarray, radius: float, max_radius: float) -> list[Level]:
    """Return levels from the mesh to coarse ones, with radii that grow from `radius` to at most `max_radius`.

    laplacian: (V, V). masses: (V,), positive. positions: (V, 3).
    """
    levels = [Level(laplacian, sparse.diags_array(masses).tocsc(), positions, 0.0, None)]
    while radius <= max_radius and len(levels[-1].positions) > TUNING.min_size and len(levels) < TUNING.max_levels:
        coarse = _coarsen(levels[-1], radius)
        if len(coarse.positions) <= TUNING.min_reduction * len(levels[-1].positions):
            levels.append(coarse)
        radius *= TUNING.radius_growth
    return levels


def _coarsen(level: Level, radius: float) -> Level:
    weights = _close_weights(level, radius)
    neighbors = (weights + sparse.eye_array(weights.shape[0])).tocsr()
    roots, aggregates = find_aggregates(neighbors, _rank(level))
    count = len(aggregates)
    tentative = sparse.csr_array((np.ones(count), (np.arange(count), aggregates)), shape=(count, len(roots)))
    sums = np.asarray(weights.sum(axis=1)).ravel()
    is_linked = sums > 0.0
    averaging = sparse.diags_array(np.where(is_linked, TUNING.smoothing, 0.0) / np.where(is_linked, sums, 1.0)) @ weights
    smoothing = (averaging + sparse.diags_array(np.where(is_linked, 1.0 - TUNING.smoothing, 1.0))).tocsr()
    prolongation, coordinates = tentative, level.positions
    for _ in range(SMOOTHING_STEPS):
        prolongation = (smoothing @ prolongation).tocsr()
    bounds = np.maximum(np.asarray(abs(level.laplacian).sum(axis=1)).ravel(), TINY)[:, None]
    for _ in range(COORDINATE_STEPS):
        coordinates = coordinates - (level.laplacian @ coordinates) / bounds
    transposed = prolongation.T.tocsr()
    laplacian = (transposed @ (level.laplacian @ prolongation)).tocsc()
    mass = (transposed @ (level.mass @ prolongation)).tocsc()
    projected = splu(mass).solve(transposed @ (level.mass @ coordinates))
    energies = [
        float(np.sum(values * (operator @ values))) for operator, values in ((level.laplacian, coordinates), (laplacian, projected))
    ]
    correction = energies[0] / energies[1] if energies[1] > TUNING.min_energy * energies[0] else 1.0
    return Level(laplacian * correction, mass, projected, radius, prolongation)


def _close_weights(level: Level, radius: float) -> sparse.csr_array:
    """Return the positive weights (n, n) between different degrees of freedom that are closer than `radius`; where the Laplacian has none
    or a negative one, a small one, because they are neighbors all the same."""
    entries = level.laplacian.tocoo()
    rows, columns = entries.coords
    distances = np.linalg.norm(level.positions[rows] - level.positions[columns], axis=1)
    used = (rows != columns) & (distances < radius)
    diagonal = level.laplacian.diagonal()
    least = 0.02 * np.minimum(diagonal[rows[used]], diagonal[columns[used]])
    values = np.maximum(-entries.data[used], np.maximum(least, np.finfo(float).tiny))
    return sparse.csr_array((values, (rows[used], columns[used])), shape=level.laplacian.shape)


def _rank(level: Level) -> np.ndarray:
    """Return the place (n,) int64 of each degree of freedom in an order that looks random but follows from masses, so that it does not
    depend on the order of vertices. Equal masses are ordered by index."""
    masses = level.mass.diagonal()
    rounded = np.rint(masses / masses.mean() * TUNING.mass_digits).astype(np.uint64)
    order = np.lexsort((_scramble(np.arange(len(masses), dtype=np.uint64)), _scramble(rounded)))
    rank = np.empty(len(masses), np.int64)
    rank[order] = np.arange(len(masses))
    return rank


def _scramble(values: np.ndarray) -> np.ndarray:
    """Return a hash (N,) uint64 of each of `values` (N,) uint64 (the finalizer of SplitMix64)."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))


def find_aggregates(neighbors: sparse.csr_array, rank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the roots (R,) in ascending order, and the aggregate (n,), below R, of each node.

    neighbors: (n, n), whose pattern is symmetric and contains the diagonal. rank: (n,) unique numbers from 0; where two nodes could be
    roots, the one with the higher rank is.
    """
    count = len(rank)
    starts, indices = neighbors.indptr[:-1], neighbors.indices

    def spread(values: np.ndarray) -> np.ndarray:
        return np.maximum.reduceat(values[indices], starts)

    is_root, is_open = np.zeros(count, bool), np.ones(count, bool)
    while is_open.any():
        candidates = np.where(is_open, rank, -1)
        is_new = is_open & (spread(spread(candidates)) == rank)
        is_root |= is_new
        is_open &= ~spread(spread(is_new))
    owner = spread(np.where(is_root, rank, -1))
    farther = spread(owner)
    owner = np.where(owner >= 0, owner, farther)
    roots = np.flatnonzero(is_root)
    index = np.zeros(count, np.int64)
    index[rank[roots]] = np.arange(len(roots))
    return roots, index[owner]


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
    try:
        factor = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:  # It is singular in double precision.
        raise GeometryError(UNSOLVABLE) from error
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
            if np.sqrt(2.0 * times[scale - 1]) >= TUNING.sigma_per_radius * coarser.radius:
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
    index = next((index for index, level in enumerate(levels) if len(level.positions) <= TUNING.search_size), len(levels) - 1)
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
        if relative < convergence * weights.sum() or sigma * TUNING.search_growth > limit:
            return sigma, largest
        sigma *= TUNING.search_growth


def _label_components(level: Level) -> np.ndarray:
    """Return the connected component (n,) of each degree of freedom."""
    return connected_components(level.laplacian, directed=False)[1]


def _find_ranges(values: np.ndarray, components: np.ndarray) -> np.ndarray:
    """Return the largest range (S,) of `values` (n, S) within one of the connected `components` (n,)."""
    order = np.argsort(components, kind="stable")
    starts = np.flatnonzero(np.diff(components[order], prepend=-1))
    return (np.maximum.reduceat(values[order], starts) - np.minimum.reduceat(values[order], starts)).max(axis=0)
