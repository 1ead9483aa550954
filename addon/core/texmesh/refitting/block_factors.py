"""Factors L D L^T of many small symmetric matrices at once, which precondition conjugate gradients."""

from dataclasses import dataclass

import numpy as np

MIN_PIVOT = 1e-10  # of a diagonal element: a smaller pivot means that rows depend on others


@dataclass(frozen=True)
class BlockFactors:
    """L D L^T of V matrices n x n. lower: (n, n, V), of which the part below the diagonal is L. inverse_pivots: (n, V), of D; 0 where a
    matrix is singular."""

    lower: np.ndarray
    inverse_pivots: np.ndarray

    def solve(self, values: np.ndarray) -> np.ndarray:
        """Return the solutions (n, V) for right-hand sides `values` (n, V)."""
        result = values.copy()
        count = len(values)
        for row in range(1, count):
            for column in range(row):
                result[row] -= self.lower[row, column] * result[column]
        result *= self.inverse_pivots
        for row in range(count - 2, -1, -1):
            for column in range(row + 1, count):
                result[row] -= self.lower[column, row] * result[column]
        return result


def factorize_blocks(blocks: np.ndarray) -> BlockFactors:
    """Return the factors of positive semidefinite `blocks` (n, n, V), of which the lower triangles are read."""
    count = len(blocks)
    lower, inverse_pivots = np.zeros_like(blocks), np.zeros_like(blocks[0])
    for column in range(count):
        scaled = [lower[column, before] * pivots for before, pivots in enumerate(_pivots(inverse_pivots[:column]))]
        pivot = blocks[column, column] - sum(lower[column, before] * part for before, part in enumerate(scaled))
        is_regular = pivot > MIN_PIVOT * blocks[column, column]
        np.divide(1.0, pivot, out=inverse_pivots[column], where=is_regular)
        for row in range(column + 1, count):
            rest = blocks[row, column] - sum(lower[row, before] * part for before, part in enumerate(scaled))
            lower[row, column] = rest * inverse_pivots[column]
    return BlockFactors(lower, inverse_pivots)


def _pivots(inverse_pivots: np.ndarray) -> np.ndarray:
    return np.divide(1.0, inverse_pivots, out=np.zeros_like(inverse_pivots), where=inverse_pivots > 0.0)
