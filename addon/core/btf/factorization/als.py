"""Weighted alternating least squares for a partially known matrix: fits each of two factors to the other in turn.

Rows are texels; columns are grouped by view. From one view, a texel is known entirely or not at all, so the normal matrix of a row is a sum
over its views. This is exact weighted PCA, out of core and without imputing unknown entries. (Weighted factorization after Srebro and
Jaakkola 2003.)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...jobs.chunks import map_ordered, slices
from ...jobs.progress import Progress, Steps

RIDGE = 1e-3  # Regularization relative to the mean diagonal of the normal matrices: keeps rows known from few views bounded.
CHUNK_ROWS = 4096  # Rows solved at once.


class ViewData(Protocol):
    """The known rows of a matrix in the columns of one view."""

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the known rows (M,) int, ascending, and their values (M, D) float32."""


@dataclass(frozen=True)
class ViewMatrix:
    """A partially known matrix of N rows and V groups of D columns, and the weights of its entries.

    views: V datasets. weights: (V, N) for every row in every view, or (V,) for all rows of a view. column_weights (D,): the same in every
    view.
    """

    views: Sequence[ViewData]
    row_count: int
    weights: np.ndarray
    column_weights: np.ndarray

    @property
    def row_weights(self) -> np.ndarray:
        """The weights as (V, N)."""
        return np.broadcast_to(self.weights.T, (self.row_count, len(self.weights))).T


def split_lights(values: np.ndarray) -> np.ndarray:
    """Reshape colors (M, L * 3) to (M, L, 3)."""
    return values.reshape(len(values), values.shape[1] // 3, 3)


class SampledView:
    """The rows `sample` (S,), ascending, of a view, renumbered 0 to S - 1. Kept in memory after the first read."""

    def __init__(self, view: ViewData, sample: np.ndarray) -> None:
        self._view, self._sample = view, sample
        self._data: tuple[np.ndarray, np.ndarray] | None = None

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and values; see `ViewData`."""
        if self._data is None:
            rows, values = self._view.read()
            _, sample_indices, indices = np.intersect1d(self._sample, rows, assume_unique=True, return_indices=True)
            self._data = sample_indices, values[indices]
        return self._data


class AlternatingLeastSquares:
    """A matrix of N rows with groups of columns, partially known from V views, and the two half steps of a sweep.

    They find weights (N, K) and basis (V, K, D), float32, for each other.

    row_weights (V, N): weight of each row in each of V `views`. sqrt_column_weights (D,): factor of the values, and thus of the basis.
    """

    def __init__(self, views: Sequence[ViewData], row_weights: np.ndarray, sqrt_column_weights: np.ndarray) -> None:
        self._views, self._row_weights, self._sqrt_column_weights = views, row_weights, sqrt_column_weights
        self._known_weights = np.zeros(row_weights.shape, np.float32)

    @property
    def known(self) -> np.ndarray:
        """Rows (N,) bool that are known from any view. Valid after the first `fit_weights` or `sweep`."""
        return self._known_weights.any(axis=0)

    @property
    def view_weights(self) -> np.ndarray:
        """Relative weight (V,) of each view."""
        return self._row_weights.mean(axis=1)

    def fit_basis(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """Return the best basis for given `weights`."""
        basis = np.zeros((len(self._views), weights.shape[1], len(self._sqrt_column_weights)), np.float32)

        def solve(view: int) -> np.ndarray:
            rows, values, row_weights = self._read(view)
            return _fit_view_basis(weights[rows], values, row_weights)

        for view, view_basis in enumerate(map_ordered(solve, range(len(self._views)))):
            yield self._progress(view)
            basis[view] = view_basis
        return basis

    def fit_weights(self, basis: np.ndarray) -> Steps[np.ndarray]:
        """Return the best weights for a given `basis`; 0 for rows that are unknown in all views."""
        return (yield from self._fit_weights(basis, None))

    def sweep(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """Fit the basis to `weights`, then the weights to the basis. Reads every view once."""
        basis = np.zeros((len(self._views), weights.shape[1], len(self._sqrt_column_weights)), np.float32)
        return (yield from self._fit_weights(basis, weights))

    def _fit_weights(self, basis: np.ndarray, weights: np.ndarray | None) -> Steps[np.ndarray]:
        """Return the best weights for `basis`. Where `weights` are given, the basis is first fitted to them, in place."""
        rhs = np.zeros((self._row_weights.shape[1], basis.shape[1]), np.float32)

        def compute_terms(view: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            rows, values, row_weights = self._read(view)
            if weights is not None:
                basis[view] = _fit_view_basis(weights[rows], values, row_weights)
            return rows, row_weights[:, 0], row_weights * (values @ basis[view].T)

        for view, (rows, row_weights, view_rhs) in enumerate(map_ordered(compute_terms, range(len(self._views)))):
            yield self._progress(view)
            rhs[rows] += view_rhs
            self._known_weights[view, rows] = row_weights
        return solve_rows(self._known_weights, basis @ basis.transpose(0, 2, 1), rhs, RIDGE)

    def _progress(self, view: int) -> Progress:
        return Progress(view / len(self._views), "Compressing")

    def _read(self, view: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the known rows (M,) of a view, their values (M, D) times `sqrt_column_weights`, and their weights (M, 1)."""
        rows, values = self._views[view].read()
        return rows, values * self._sqrt_column_weights, self._row_weights[view, rows, None]


def solve_rows(row_weights: np.ndarray, grams: np.ndarray, rhs: np.ndarray, ridge: float | np.ndarray) -> np.ndarray:
    """Solve the normal equations of every row for its weights (N, K) float32; 0 for rows without any weight.

    The normal matrix of a row is the sum over views of `row_weights` (V, N) times `grams` (V, K, K); `rhs` (N, K) is the right-hand side.
    `ridge`, a number or (K,), times the mean diagonal of the rows with weight is added to each diagonal.
    """
    count = rhs.shape[1]
    diagonal = np.einsum("vkk->v", grams).astype(np.float64) @ row_weights / count
    known = diagonal > 0.0
    regularization = (diagonal[known].mean() if known.any() else 1.0) * ridge * np.eye(count)
    flat_grams = grams.reshape(len(grams), -1).astype(np.float32)

    def solve(rows: slice) -> np.ndarray:
        normal = (row_weights[:, rows].T.astype(np.float32) @ flat_grams).reshape(-1, count, count)
        solution = np.linalg.solve(normal.astype(np.float64) + regularization, rhs[rows, :, None].astype(np.float64))
        return solution[..., 0].astype(np.float32)

    return np.concatenate([np.zeros((0, count), np.float32), *map_ordered(solve, slices(len(rhs), CHUNK_ROWS))])


def solve_basis(normal: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solve regularized normal equations `normal` (..., K, K), `rhs` (..., K, D) for bases (..., K, D) float32. They may be singular."""
    count = normal.shape[-1]
    regularization = 1e-6 * np.trace(normal, axis1=-2, axis2=-1) / count + 1e-12
    return np.linalg.solve(normal + regularization[..., None, None] * np.eye(count), rhs).astype(np.float32)


def _fit_view_basis(weights: np.ndarray, values: np.ndarray, row_weights: np.ndarray) -> np.ndarray:
    """Return the basis (K, D) that best reconstructs `values` (M, D) from `weights` (M, K), with `row_weights` (M, 1)."""
    weighted = (row_weights * weights).T
    return solve_basis((weighted @ weights).astype(np.float64), (weighted @ values).astype(np.float64))
