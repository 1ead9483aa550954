"""Alternating least squares: of a matrix that is known in part, the factor that suits the other one best.

Rows are texels, columns come in groups: all that was seen of a texel from one view. From a view a texel is known as a whole or not at all,
so the least-squares problem of every row has a normal matrix that is a sum over its views: exact weighted PCA, out of core, without
filling in what is not known. (Factorisation with weights after Srebro and Jaakkola 2003.)
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..parallel import mapped, slices
from ..progress import Progress, Steps

RIDGE = 1e-3  # of the mean diagonal of a row's normal matrix: rows seen from few views do not run away
CHUNK = 4096  # rows solved at once


class ViewData(Protocol):
    """What one view knows."""

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (M,) int that are known from it, ascending, and their values (M, D) float32."""


class Alternating(Protocol):
    """A matrix of N rows that V views know in part, and its factors in turn: weights (N, K) and a basis (V, K, D), float32."""

    @property
    def known(self) -> np.ndarray:
        """Rows (N,) bool that any view knows; told after the first `rows` or `improved`."""

    @property
    def view_weights(self) -> np.ndarray:
        """What each view counts (V,), up to a factor."""

    def basis(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """The basis that suits `weights` best."""

    def rows(self, basis: np.ndarray) -> Steps[np.ndarray]:
        """The weights that suit `basis` best; 0 of rows that no view knows."""

    def improved(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """The weights that suit the basis best which suits `weights` best."""


def by_light(values: np.ndarray) -> np.ndarray:
    """Colours (M, L * 3) as (M, L, 3)."""
    return values.reshape(len(values), values.shape[1] // 3, 3)


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
    """See `Alternating`. counting (V, N): what each row counts from each of V `views`; roots (D,): of what each column counts.

    Values, and so the basis, are those of the matrix times the roots.
    """

    def __init__(self, views: Sequence[ViewData], counting: np.ndarray, roots: np.ndarray) -> None:
        self._views, self._counting, self._roots = views, counting, roots
        self._shares = np.zeros(counting.shape, np.float32)

    @property
    def known(self) -> np.ndarray:
        """See `Alternating`."""
        return self._shares.any(axis=0)

    @property
    def view_weights(self) -> np.ndarray:
        """See `Alternating`."""
        return self._counting.mean(axis=1)

    def basis(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """See `Alternating`."""
        basis = np.zeros((len(self._views), weights.shape[1], len(self._roots)), np.float32)

        def solved(place: int) -> np.ndarray:
            index, values, own = self._read(place)
            return _solved_basis(weights[index], values, own)

        for place, found in enumerate(mapped(solved, range(len(self._views)))):
            yield self._progress(place)
            basis[place] = found
        return basis

    def rows(self, basis: np.ndarray) -> Steps[np.ndarray]:
        """See `Alternating`."""
        return (yield from self._rows(basis, None))

    def improved(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """See `Alternating`; the matrix is read once."""
        basis = np.zeros((len(self._views), weights.shape[1], len(self._roots)), np.float32)
        return (yield from self._rows(basis, weights))

    def _rows(self, basis: np.ndarray, weights: np.ndarray | None) -> Steps[np.ndarray]:
        """The weights that suit `basis` best, which is first made to suit `weights` where these are given."""
        right = np.zeros((self._counting.shape[1], basis.shape[1]), np.float32)

        def terms(place: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            index, values, own = self._read(place)
            if weights is not None:
                basis[place] = _solved_basis(weights[index], values, own)
            return index, own[:, 0], own * (values @ basis[place].T)

        for place, (index, own, part) in enumerate(mapped(terms, range(len(self._views)))):
            yield self._progress(place)
            right[index] += part
            self._shares[place, index] = own
        return solved_rows(self._shares, basis @ basis.transpose(0, 2, 1), right, RIDGE)

    def _progress(self, place: int) -> Progress:
        return Progress(place / len(self._views), "Compressing")

    def _read(self, place: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (M,) that a view knows, their values times the roots (M, D), and what they count (M, 1)."""
        index, values = self._views[place].read()
        return index, values * self._roots, self._counting[place, index, None]


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
    flat = grams.reshape(len(grams), -1).astype(np.float32)

    def solved(rows: slice) -> np.ndarray:
        normal = (shares[:, rows].T.astype(np.float32) @ flat).reshape(-1, count, count)
        return np.linalg.solve(normal.astype(np.float64) + padding, right[rows, :, None].astype(np.float64))[..., 0].astype(np.float32)

    return np.concatenate([np.zeros((0, count), np.float32), *mapped(solved, slices(len(right), CHUNK))])


def _solved_basis(weights: np.ndarray, values: np.ndarray, counting: np.ndarray) -> np.ndarray:
    """The basis (K, D) that fits `values` (M, D) best from `weights` (M, K), rows counting (M, 1)."""
    turned = (counting * weights).T
    return solved_basis((turned @ weights).astype(np.float64), (turned @ values).astype(np.float64))


def solved_basis(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Bases (..., K, D) float32 with normal equations `left` (..., K, K) and `right` (..., K, D), which may say little or nothing."""
    count = left.shape[-1]
    padding = 1e-6 * np.trace(left, axis1=-2, axis2=-1) / count + 1e-12
    return np.linalg.solve(left + padding[..., None, None] * np.eye(count), right).astype(np.float32)
