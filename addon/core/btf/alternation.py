"""Alternating least squares: of a matrix that is known in part, the factor that suits the other one best.

Rows are texels, columns come in groups: all that was seen of a texel from one view. From a view a texel is known as a whole or not at all,
so the least-squares problem of every row has a normal matrix that is a sum over its views: exact weighted PCA, out of core, without
filling in what is not known. (Factorisation with weights after Srebro and Jaakkola 2003.)
"""

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from ..progress import Progress, Steps

RIDGE = 1e-3  # of the mean diagonal of a row's normal matrix: rows seen from few views do not run away
CHUNK = 16_384  # rows solved at once


class ViewData(Protocol):
    """What one view knows."""

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (M,) int that are known from it, ascending, and their values (M, D) float32."""


class Sampled:
    """What a view knows of the rows `chosen` (S,), ascending, which are numbered anew; kept in memory once it was read."""

    def __init__(self, view: ViewData, chosen: np.ndarray) -> None:
        self._view, self._chosen = view, chosen
        self._held: tuple[np.ndarray, np.ndarray] | None = None

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """See `ViewData`."""
        if self._held is None:
            index, values = self._view.read()
            _, numbers, places = np.intersect1d(self._chosen, index, assume_unique=True, return_indices=True)
            self._held = numbers, values[places]
        return self._held


class Alternation:
    """A matrix as V `views` know it. counting (V, N): what each row counts from each view; roots (D,): of what each column counts.

    Values, and so the basis, are those of the matrix times the roots.
    """

    def __init__(self, views: Sequence[ViewData], counting: np.ndarray, roots: np.ndarray) -> None:
        self._views, self._counting, self._roots = views, counting, roots
        self._shares = np.zeros(counting.shape, np.float32)

    @property
    def known(self) -> np.ndarray:
        """Rows (N,) that any view knows; told after the first `rows` or `improved`."""
        return self._shares.any(axis=0)

    def basis(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """The basis (V, K, D) that suits `weights` (N, K) best."""
        basis = np.zeros((len(self._views), weights.shape[1], len(self._roots)), np.float32)
        for place, index, values, own in self._read():
            yield self._progress(place)
            basis[place] = _solved_basis(weights[index], values, own)
        return basis

    def rows(self, basis: np.ndarray) -> Steps[np.ndarray]:
        """The weights (N, K) that suit `basis` (V, K, D) best."""
        right = np.zeros((self._counting.shape[1], basis.shape[1]), np.float32)
        for place, index, values, own in self._read():
            yield self._progress(place)
            self._add(right, place, index, values, own, basis[place])
        return self._solved(basis, right)

    def improved(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """The weights that suit the basis best which suits `weights` best, reading the matrix once."""
        basis = np.zeros((len(self._views), weights.shape[1], len(self._roots)), np.float32)
        right = np.zeros(weights.shape, np.float32)
        for place, index, values, own in self._read():
            yield self._progress(place)
            basis[place] = _solved_basis(weights[index], values, own)
            self._add(right, place, index, values, own, basis[place])
        return self._solved(basis, right)

    def _read(self) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
        for place, view in enumerate(self._views):
            index, values = view.read()
            yield place, index, values * self._roots, self._counting[place, index, None]

    def _progress(self, place: int) -> Progress:
        return Progress(place / len(self._views), "Compressing")

    def _add(self, right: np.ndarray, place: int, index: np.ndarray, values: np.ndarray, own: np.ndarray, basis: np.ndarray) -> None:
        right[index] += own * (values @ basis.T)
        self._shares[place, index] = own[:, 0]

    def _solved(self, basis: np.ndarray, right: np.ndarray) -> np.ndarray:
        return solved_rows(self._shares, basis @ basis.transpose(0, 2, 1), right, RIDGE)


def of_all_rows(weights: np.ndarray, rows: int) -> np.ndarray:
    """Weights (V, N) of N rows, which may be given as (V,)."""
    return np.broadcast_to(weights.T, (rows, len(weights))).T


def solved_rows(shares: np.ndarray, grams: np.ndarray, right: np.ndarray, ridge: float | np.ndarray) -> np.ndarray:
    """The weights (N, K) float32 that solve every row's equations; 0 where a row has no share.

    On the left is the sum over views of `shares` (V, N) times `grams` (V, K, K), `right` (N, K) on the right.

    `ridge`, one number or (K,), is added to each diagonal, as a share of the mean diagonal of the rows that have shares.
    """
    count = right.shape[1]
    diagonal = np.einsum("vkk->v", grams).astype(np.float64) @ shares / count
    known = diagonal > 0.0
    padding = (diagonal[known].mean() if known.any() else 1.0) * ridge * np.eye(count)
    weights = np.zeros(right.shape, np.float32)
    flat = grams.reshape(len(grams), -1).astype(np.float32)
    for start in range(0, len(right), CHUNK):
        rows = slice(start, start + CHUNK)
        normal = (shares[:, rows].T.astype(np.float32) @ flat).reshape(-1, count, count)
        weights[rows] = np.linalg.solve(normal.astype(np.float64) + padding, right[rows, :, None].astype(np.float64))[..., 0]
    return weights


def _solved_basis(weights: np.ndarray, values: np.ndarray, counting: np.ndarray) -> np.ndarray:
    """The basis (K, D) that fits `values` (M, D) best from `weights` (M, K), rows counting (M, 1)."""
    turned = (counting * weights).T
    normal = (turned @ weights).astype(np.float64)
    normal += (1e-6 * np.trace(normal) / len(normal) + 1e-12) * np.eye(len(normal))
    return np.linalg.solve(normal, (turned @ values).astype(np.float64)).astype(np.float32)
