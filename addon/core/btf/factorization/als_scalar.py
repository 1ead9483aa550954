"""Alternating least squares with one column per view, such as coverage or the angle to a shadow boundary; see `als`.

With one column per view, batching by view gains nothing. The equations of many rows, or of all views, are products of whole matrices.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from ...jobs.chunks import map_ordered, slices
from ...jobs.progress import Progress, Steps
from .als import RIDGE, solve_basis

CHUNK_ROWS = 4096  # Rows processed at once.

Result = TypeVar("Result")


class ScalarData(Protocol):
    """A partially known matrix with N rows and one column for each of V views."""

    @property
    def shape(self) -> tuple[int, int]:
        """Number of views V and of rows N."""

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values (V, M) and weights (V, M) of `rows`, float32; weight 0 marks unknown entries."""


@dataclass(frozen=True)
class InMemoryScalarData:
    """`ScalarData` in memory: values (V, N) and weights (V, N), float32."""

    values: np.ndarray
    weights: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Number of views V and of rows N."""
        return self.values.shape

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values and weights of `rows`; see `ScalarData`."""
        return self.values[:, rows], self.weights[:, rows]


class ScalarAlternatingLeastSquares:
    """As `AlternatingLeastSquares`, for a matrix with one column per view (D = 1). Create it with `build_scalar_als`."""

    def __init__(self, data: ScalarData, known: np.ndarray, view_weights: np.ndarray) -> None:
        self._data, self.known, self.view_weights = data, known, view_weights
        self._view_count, self._row_count = data.shape

    def fit_basis(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """Return the best basis for given `weights`."""
        count = weights.shape[1]
        normal, rhs = np.zeros((self._view_count, count * (count + 1) // 2)), np.zeros((self._view_count, count))

        def compute_terms(rows: slice) -> tuple[np.ndarray, np.ndarray]:
            values, data_weights = self._data.read(rows)
            return data_weights @ _upper_outer_products(weights[rows]), (data_weights * values) @ weights[rows]

        for rows, (chunk_normal, chunk_rhs) in _map_chunks(compute_terms, self._row_count):
            yield self._progress(rows)
            normal += chunk_normal
            rhs += chunk_rhs
        return solve_basis(_symmetric_from_upper(normal, count), rhs[..., None])

    def fit_weights(self, basis: np.ndarray) -> Steps[np.ndarray]:
        """Return the best weights for a given `basis`."""
        flat = basis[..., 0]
        outer_products, count = _upper_outer_products(flat), flat.shape[1]
        diagonal = self.view_weights @ (flat**2).sum(axis=1) / count
        regularization = (diagonal / max(int(self.known.sum()), 1) or 1.0) * RIDGE * np.eye(count)

        def solve(rows: slice) -> np.ndarray:
            values, data_weights = self._data.read(rows)
            normal = _symmetric_from_upper((data_weights.T @ outer_products).astype(np.float64), count) + regularization
            rhs = ((data_weights * values).T @ flat)[..., None].astype(np.float64)
            return np.linalg.solve(normal, rhs)[..., 0].astype(np.float32)

        weights = [np.zeros((0, count), np.float32)]
        for rows, chunk_weights in _map_chunks(solve, self._row_count):
            yield self._progress(rows)
            weights.append(chunk_weights)
        return np.concatenate(weights)

    def sweep(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """Fit the basis to `weights`, then return the best weights for that basis."""
        basis = yield from self.fit_basis(weights)
        return (yield from self.fit_weights(basis))

    def _progress(self, rows: slice) -> Progress:
        return Progress(rows.start / self._row_count, "Compressing")


def build_scalar_als(data: ScalarData) -> Steps[ScalarAlternatingLeastSquares]:
    """Build the problem of `data`, reading it once."""
    view_count, row_count = data.shape
    known, view_weights = np.zeros(row_count, bool), np.zeros(view_count)
    for rows, (_, weights) in _map_chunks(data.read, row_count):
        yield Progress(rows.start / row_count, "Compressing")
        known[rows] = weights.any(axis=0)
        view_weights += weights.sum(axis=1, dtype=np.float64)
    return ScalarAlternatingLeastSquares(data, known, view_weights)


def _map_chunks(function: Callable[[slice], Result], row_count: int) -> Iterator[tuple[slice, Result]]:
    """Yield chunks of rows and the results of `function` for them, computed on several cores."""
    chunks = slices(row_count, CHUNK_ROWS)
    return zip(chunks, map_ordered(function, chunks), strict=True)


def _upper_outer_products(vectors: np.ndarray) -> np.ndarray:
    """Return the upper triangles (M, K (K + 1) / 2) of the outer products of each of `vectors` (M, K) with itself."""
    rows, columns = np.triu_indices(vectors.shape[1])
    return vectors[:, rows] * vectors[:, columns]


def _symmetric_from_upper(triangles: np.ndarray, count: int) -> np.ndarray:
    """Return the symmetric matrices (M, K, K) with the upper triangles `triangles` (M, K (K + 1) / 2)."""
    rows, columns = np.triu_indices(count)
    indices = np.empty((count, count), np.int64)
    indices[rows, columns] = indices[columns, rows] = np.arange(len(rows))
    return triangles[:, indices]
