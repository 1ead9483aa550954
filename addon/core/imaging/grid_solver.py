"""Sparse symmetric systems whose unknowns are pixels: conjugate gradients with a multigrid preconditioner.

Coarse unknowns are blocks of 2 x 2 pixels, with Galerkin coefficients, so that masks and barriers of any shape keep their connections
(aggregation multigrid: Notay, "An aggregation-based algebraic multigrid method", 2010).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import SuperLU, splu

MAX_DIRECT_UNKNOWNS = 60_000  # above this, a factorization takes more memory and time than conjugate gradients
MAX_ITERATIONS = 500
SMOOTHING = 0.7  # damping of a Jacobi step
OVERCORRECTION = 1.6  # Piecewise constant corrections are too small by about this factor.


def solve_linked(
    diagonal: np.ndarray,
    links: tuple[np.ndarray, np.ndarray],
    positions: np.ndarray,
    right_side: np.ndarray,
    start: Callable[[], np.ndarray],
) -> np.ndarray:
    """Return the solution (U, C) of a system with the given `diagonal` (U,) and -1 for each of `links`, two arrays (L,) of unknowns.

    Few unknowns are solved for by factorization, more by `solve_grid`, which explains the other arguments; `start` is called only then.
    """
    size = len(diagonal)
    weights = coo_matrix((np.ones(len(links[0])), links), shape=(size, size)).tocsr()
    matrix = csr_matrix((diagonal, (np.arange(size), np.arange(size))), shape=(size, size)) - weights
    return _factorize(matrix).solve(right_side) if size <= MAX_DIRECT_UNKNOWNS else solve_grid(matrix, positions, right_side, start())


@dataclass(frozen=True)
class _Level:
    """One level: its matrix, the inverse of its diagonal, and the map (U,) from its unknowns to those of the next coarser level."""

    matrix: csr_matrix
    inverse_diagonal: np.ndarray
    blocks: np.ndarray
    prolongation: csr_matrix


def solve_grid(matrix: csr_matrix, positions: np.ndarray, right_side: np.ndarray, start: np.ndarray, tolerance: float = 1e-7) -> np.ndarray:
    """Return the solution (U, C) of `matrix` (U, U) times x = `right_side` (U, C).

    matrix: symmetric positive definite with the pattern of a pixel grid. positions: (U, 2) int, row and column of each unknown. start:
    (U, C) first guess. The residual becomes `tolerance` times the right side, in the maximum over the columns.
    """
    levels, coarsest = _build_levels(matrix, positions)
    solution = start.astype(np.float64).copy()
    residual = right_side - matrix @ solution
    limit = tolerance * max(float(np.linalg.norm(right_side, axis=0).max()), 1e-30)
    direction = np.zeros_like(solution)
    product = np.ones(solution.shape[1])
    for iteration in range(MAX_ITERATIONS):
        if np.linalg.norm(residual, axis=0).max() <= limit:
            break
        preconditioned = _cycle(levels, coarsest, residual, 0)
        new_product = np.einsum("ij,ij->j", residual, preconditioned)
        direction = preconditioned + (new_product / product if iteration else 0.0) * direction
        product = np.where(new_product > 0.0, new_product, 1.0)
        image = matrix @ direction
        curvature = np.einsum("ij,ij->j", direction, image)
        step = np.where(curvature > 0.0, new_product / np.where(curvature > 0.0, curvature, 1.0), 0.0)
        solution += step * direction
        residual -= step * image
    return solution


def _build_levels(matrix: csr_matrix, positions: np.ndarray):
    """Return the levels from fine to coarse, and the factorization of the coarsest matrix."""
    levels = []
    while matrix.shape[0] > 2000:
        positions = positions // 2
        width = int(positions[:, 1].max()) + 1
        keys, blocks = np.unique(positions[:, 0].astype(np.int64) * width + positions[:, 1], return_inverse=True)
        count = len(blocks)
        prolongation = csr_matrix((np.ones(count), (np.arange(count), blocks)), shape=(count, len(keys)))
        levels.append(_Level(matrix, 1.0 / matrix.diagonal()[:, None], blocks, prolongation))
        matrix = (prolongation.T @ matrix @ prolongation).tocsr()
        positions = np.stack([keys // width, keys % width], axis=1)
    return levels, _factorize(matrix)


def _factorize(matrix: csr_matrix) -> SuperLU:
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


def _cycle(levels: list[_Level], coarsest, residual: np.ndarray, depth: int) -> np.ndarray:
    """Return an approximate solution for `residual` (U, C): one symmetric V-cycle from level `depth` down."""
    if depth == len(levels):
        return coarsest.solve(residual)
    level = levels[depth]
    solution = SMOOTHING * level.inverse_diagonal * residual
    solution += SMOOTHING * level.inverse_diagonal * (residual - level.matrix @ solution)
    coarse = level.prolongation.T @ (residual - level.matrix @ solution)
    solution += OVERCORRECTION * _cycle(levels, coarsest, coarse, depth + 1)[level.blocks]
    for _ in range(2):
        solution += SMOOTHING * level.inverse_diagonal * (residual - level.matrix @ solution)
    return solution
