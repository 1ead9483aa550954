"""Coarse versions of a Laplacian and its masses for scales that are large compared to the triangles: smoothed aggregation.

Vertices that are close together become an aggregate, around roots that are a maximal independent set at distance two (Bell, Dalton and
Olson, "Exposing Fine-Grained Parallelism in Algebraic Multigrid Methods", 2012). Functions on aggregates are smoothed, and Laplacian and
masses are projected onto them (Galerkin). Where vertices are farther apart than the radius of a level they remain, so that the coarse
functions are about equally wide on irregular meshes.

Such functions have a larger gradient than those that they approximate. The Laplacian is divided by the factor by which this changes the
energy of smooth functions (overcorrection, as in Braess, "Towards Algebraic Multigrid for Elliptic Problems of Second Order", 1995).
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ...arrays import TINY

RADIUS_GROWTH = 2.5  # between two levels: that of the distance between roots
MIN_SIZE = 400  # degrees of freedom below which a level is not coarsened
MAX_LEVELS = 12
MIN_REDUCTION = 0.9  # of the size: levels that reduce less are left out
SMOOTHING = 2.0 / 3.0  # damping of the Jacobi steps that smooth functions on aggregates
SMOOTHING_STEPS, COORDINATE_STEPS = 2, 12  # of functions on aggregates, and of the coordinates whose energy is compared
MIN_ENERGY = 0.1  # of coarse coordinates relative to fine ones; below, most components have become points
MASS_DIGITS = 1e5  # mass relative to the mean is rounded to this for an order that does not depend on that of the vertices


@dataclass(frozen=True)
class Level:
    """Laplacian and mass (n, n) of functions with n degrees of freedom at `positions` (n, 3).

    radius: distance within which vertices were aggregated, 0 for the mesh itself. prolongation: (n of the finer level, n), None there.
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
    while radius <= max_radius and len(levels[-1].positions) > MIN_SIZE and len(levels) < MAX_LEVELS:
        coarse = _coarsen(levels[-1], radius)
        if len(coarse.positions) <= MIN_REDUCTION * len(levels[-1].positions):
            levels.append(coarse)
        radius *= RADIUS_GROWTH
    return levels


def _coarsen(level: Level, radius: float) -> Level:
    weights = _close_weights(level, radius)
    neighbors = (weights + sparse.eye_array(weights.shape[0])).tocsr()
    roots, aggregates = find_aggregates(neighbors, _rank(level))
    count = len(aggregates)
    tentative = sparse.csr_array((np.ones(count), (np.arange(count), aggregates)), shape=(count, len(roots)))
    sums = np.asarray(weights.sum(axis=1)).ravel()
    is_linked = sums > 0.0
    averaging = sparse.diags_array(np.where(is_linked, SMOOTHING, 0.0) / np.where(is_linked, sums, 1.0)) @ weights
    smoothing = (averaging + sparse.diags_array(np.where(is_linked, 1.0 - SMOOTHING, 1.0))).tocsr()
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
    correction = energies[0] / energies[1] if energies[1] > MIN_ENERGY * energies[0] else 1.0
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
    rounded = np.rint(masses / masses.mean() * MASS_DIGITS).astype(np.uint64)
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
