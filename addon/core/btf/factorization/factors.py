"""Low-rank factors of a partially known matrix, see `als`, and their error against the captured values.

(The paper compresses with local PCA after imputing unknown entries, section 5.2; see `lpca`.)
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import TINY
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps, subprogress
from .als import AlternatingLeastSquares, SampledView, ViewMatrix
from .als_scalar import InMemoryScalarData, ScalarAlternatingLeastSquares, ScalarData, build_scalar_als

LeastSquares = AlternatingLeastSquares | ScalarAlternatingLeastSquares

SAMPLE_SWEEPS = 8  # Over a sample of the rows, which is kept in memory.
SAMPLE_ROWS = 8192
SAMPLE_END, WEIGHTS_END, SWEEP_END = 0.3, 0.6, 0.85  # Ends of the stages in the progress bar of `_factorize`.
PEAK_QUANTILE = 0.99  # This quantile of the captured values is the peak signal of the PSNR.
SAMPLE_TEXELS = 8192  # About.


@dataclass(frozen=True)
class Factors:
    """Factors of a matrix: the values of row x in view v are about weights[x] @ basis[v].

    weights (N, K) float32: the largest magnitude of every column is 1. basis (V, K, D) float32: components in order of decreasing energy.
    known (N,) bool: rows that are known from any view.
    """

    weights: np.ndarray
    basis: np.ndarray
    known: np.ndarray

    @property
    def components(self) -> int:
        """Number of components K of each row."""
        return self.weights.shape[1]

    @property
    def clusters(self) -> int:
        """Number of sets of components. Every row uses one set."""
        return 1

    @property
    def nbytes(self) -> int:
        """Size as half floats."""
        return 2 * (self.weights.size + self.basis.size)

    def reconstruct(self, basis: np.ndarray) -> np.ndarray:
        """Return the values (N, D) of all rows for a `basis` (clusters * K, D), such as that of one view."""
        return self.weights @ basis

    def dense_weights(self, rows: slice | np.ndarray) -> np.ndarray:
        """Return the weights (M, clusters * K) of `rows`; 0 for components of other clusters."""
        return self.weights[rows]

    def component_contribution(self, rows: np.ndarray, view: int, component: int) -> np.ndarray:
        """Return the contribution of one component to the values (M, D) of `rows` (M,) in a view."""
        return self.weights[rows, component, None] * self.basis[view, component]


def factorize(matrix: ViewMatrix, components: int, seed: int = 0) -> Steps[Factors]:
    """Factorize `matrix`. The basis is first fitted to a sample of its rows, then to all of them."""
    sqrt_column_weights = np.sqrt(matrix.column_weights / matrix.column_weights.mean()).astype(np.float32)
    normalized = replace(matrix, weights=(matrix.weights / matrix.weights.mean()).astype(np.float32))
    row_weights = normalized.row_weights
    sample = _sample_rows(matrix.row_count)
    full = sampled = AlternatingLeastSquares(matrix.views, row_weights, sqrt_column_weights)
    if len(sample) < matrix.row_count:
        views = [SampledView(view, sample) for view in matrix.views]
        sampled = AlternatingLeastSquares(views, row_weights[:, sample], sqrt_column_weights)
    factors = yield from _factorize(full, sampled, len(sample), components, seed)
    return replace(factors, basis=factors.basis / sqrt_column_weights)


def factorize_scalar(data: ScalarData, components: int, seed: int = 0) -> Steps[Factors]:
    """Factorize a matrix with one column per view; D is 1."""
    sample = _sample_rows(data.shape[1])
    full = sampled = yield from subprogress(build_scalar_als(data), 0.0, 0.0)
    if len(sample) < data.shape[1]:
        sampled = yield from subprogress(build_scalar_als(InMemoryScalarData(*data.read(sample))), 0.0, 0.0)
    return (yield from _factorize(full, sampled, len(sample), components, seed))


def _sample_rows(row_count: int) -> np.ndarray:
    """Return the indices (S,) of SAMPLE_ROWS evenly spaced rows, ascending, or of all rows."""
    return np.unique(np.linspace(0, row_count - 1, min(row_count, SAMPLE_ROWS)).round().astype(np.int64))


def _factorize(full: LeastSquares, sampled: LeastSquares, sample_count: int, components: int, seed: int) -> Steps[Factors]:
    """Factorize `full`, starting with the problem `sampled` of a subset of its rows, or with `full` itself."""
    weights = np.random.default_rng(seed).standard_normal((sample_count, components)).astype(np.float32)
    weights[:, 0] = 1.0
    for sweep in range(SAMPLE_SWEEPS):
        start, end = SAMPLE_END * sweep / SAMPLE_SWEEPS, SAMPLE_END * (sweep + 1) / SAMPLE_SWEEPS
        weights = yield from subprogress(sampled.sweep(weights), start, end)
    if sampled is not full:
        basis = yield from subprogress(sampled.fit_basis(weights), SAMPLE_END, SAMPLE_END)
        weights = yield from subprogress(full.fit_weights(basis), SAMPLE_END, WEIGHTS_END)
        weights = yield from subprogress(full.sweep(weights), WEIGHTS_END, SWEEP_END)
    basis = yield from subprogress(full.fit_basis(weights), SWEEP_END, 1.0)
    return Factors(*_orthogonalize(weights, basis, full.view_weights), full.known)


def _orthogonalize(weights: np.ndarray, basis: np.ndarray, view_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the same product with orthogonal components of decreasing energy, and the columns of weights scaled to a magnitude of 1."""
    basis_gram = np.einsum("v,vkd,vld->kl", view_weights, basis, basis, optimize=True).astype(np.float64)
    weight_gram = (weights.T @ weights).astype(np.float64)
    # Both Gram matrices are diagonalized at once: with basis_gram = R R', the eigenvectors of R' weight_gram R diagonalize the weights
    # and turn the basis into an orthonormal one.
    values, vectors = np.linalg.eigh(basis_gram)
    values = np.maximum(values, max(1e-12 * values.max(initial=0.0), 1e-30))  # All may be 0.
    root, inverse = vectors * np.sqrt(values), vectors / np.sqrt(values)
    _, rotation = np.linalg.eigh(root.T @ weight_gram @ root)
    rotation = rotation[:, ::-1]
    to_weights, to_basis = root @ rotation, (inverse @ rotation).T
    weights, basis = weights @ to_weights.astype(np.float32), np.einsum("jk,vkd->vjd", to_basis.astype(np.float32), basis)
    magnitudes = np.abs(weights).max(axis=0, initial=0.0)
    magnitudes[magnitudes == 0.0] = 1.0
    return weights / magnitudes, basis * magnitudes[:, None]


@dataclass(frozen=True)
class ComponentError:
    """Error with `components` components. rms: root mean square, with the weights of views and columns. psnr: in decibels."""

    components: int
    rms: float
    psnr: float


def error_by_components(
    matrix: ViewMatrix,
    factors: Factors,
    chromaticity: np.ndarray,
    offset: Callable[[int, np.ndarray], np.ndarray] | None = None,
) -> Steps[list[ComponentError]]:
    """Measure the error of `factors` times `chromaticity` (N, 3) for every number of components from 0 on, on an even sample of the texels.
    Noise in the captured values of `matrix` counts as error.

    offset: function of a view and rows (M,) that returns values (M, D) to add to those of the factors.
    """
    row_weights = matrix.row_weights
    stride = max(1, matrix.row_count // SAMPLE_TEXELS)
    column_weights = matrix.column_weights.astype(np.float32)

    def measure(view: int) -> tuple[np.ndarray, float, float]:
        """Return the weighted squared errors (K + 1,) of a view, its sum of weights, and its peak."""
        squared_errors = np.zeros(factors.components + 1)
        rows, values = matrix.views[view].read()
        is_sampled = rows % stride == 0
        rows, values = rows[is_sampled], values[is_sampled]
        if len(rows) == 0:
            return squared_errors, 0.0, 0.0
        factor = np.tile(chromaticity[rows], (1, values.shape[1] // 3))
        residual = values if offset is None else values - offset(view, rows)
        weights = row_weights[view, rows]
        for count in range(len(squared_errors)):
            if count:
                residual = residual - factor * factors.component_contribution(rows, view, count - 1)
            squared_errors[count] = float(weights @ (np.square(residual) @ column_weights).astype(np.float64))
        return squared_errors, float(weights.sum()) * float(matrix.column_weights.sum()), float(np.quantile(values, PEAK_QUANTILE))

    squared_errors, total_weight, peak = np.zeros(factors.components + 1), 0.0, 0.0
    for view, (view_errors, view_weight, view_peak) in enumerate(map_ordered(measure, range(len(matrix.views)))):
        yield Progress(view / len(matrix.views), "Measuring")
        squared_errors, total_weight, peak = squared_errors + view_errors, total_weight + view_weight, max(peak, view_peak)
    rms = np.sqrt(squared_errors / max(total_weight, TINY))
    return [
        ComponentError(count, float(error), float(20.0 * np.log10(max(peak or 1.0, 1e-12) / max(error, 1e-12))))
        for count, error in enumerate(rms)
    ]
