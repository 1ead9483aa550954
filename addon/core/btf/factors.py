"""Low-rank factors of a matrix that is known in part: alternating least squares, one pass over the data each.

Rows are texels, columns come in groups: all that was seen of a texel from one view. From a view a texel is known as a whole or not at all,
so the least-squares problem of every row has a normal matrix that is a sum over its views: exact weighted PCA, out of core, without
filling in what is not known. (The paper compresses with local PCA after filling, section 5.2; factorisation with weights after Srebro and
Jaakkola 2003.)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..progress import Progress, Steps

PASSES = 8
RIDGE = 1e-3  # of the mean diagonal of a row's normal matrix: rows seen from few views do not run away
CHUNK = 16_384  # rows solved at once


class ViewData(Protocol):
    """What one view knows."""

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (M,) int that are known from it, ascending, and their values (M, D) float32."""


@dataclass(frozen=True)
class Factors:
    """values of view v and row x are about weights[x] @ basis[v]. weights (N, K) float32; basis (V, K, D) float32.

    Components come in falling energy; every column of `weights` has a largest magnitude of 1. known (N,) bool: rows seen from any view.
    """

    weights: np.ndarray
    basis: np.ndarray
    known: np.ndarray

    @property
    def components(self) -> int:
        """K."""
        return self.weights.shape[1]

    @property
    def clusters(self) -> int:
        """How many sets of components there are; every row has those of one."""
        return 1

    @property
    def bytes(self) -> int:
        """What it takes as half floats."""
        return 2 * (self.weights.size + self.basis.size)

    def applied(self, basis: np.ndarray) -> np.ndarray:
        """The values (N, D) of all rows with `basis` (clusters * K, D), that of a view for instance."""
        return self.weights @ basis

    def spread(self, rows: slice) -> np.ndarray:
        """The weights (M, clusters * K) of some rows, 0 for the components of other clusters than their own."""
        return self.weights[rows]

    def part(self, rows: np.ndarray, view: int, number: int) -> np.ndarray:
        """What component `number` alone adds to the values (M, D) of `rows` (M,) in a view."""
        return self.weights[rows, number, None] * self.basis[view, number]


def factorise(
    views: Sequence[ViewData], rows: int, components: int, weights: np.ndarray, column_weights: np.ndarray, seed: int = 0
) -> Steps[Factors]:
    """Factors of the matrix that `views` know.

    Args:
        weights: (V, N) what each row counts from each view, or (V,) for all rows alike. column_weights: (D,) what each column counts.
    """
    random = np.random.default_rng(seed)
    roots = np.sqrt(column_weights / column_weights.mean()).astype(np.float32)
    counting = of_all_rows((weights / weights.mean()).astype(np.float32), rows)
    found = random.standard_normal((rows, components)).astype(np.float32)
    found[:, 0] = 1.0
    basis = np.zeros((len(views), components, len(roots)), np.float32)
    shares = np.zeros((len(views), rows), np.float32)
    for number in range(PASSES + 1):
        last = number == PASSES
        right = np.zeros((rows, components), np.float32)
        for place, view in enumerate(views):
            yield Progress((number + place / len(views)) / (PASSES + 1), f"Compressing, pass {number + 1} of {PASSES + 1}")
            index, values = view.read()
            scaled = values * roots
            own = counting[place, index, None]
            basis[place] = _solved_basis(found[index], scaled, own)
            if not last:
                right[index] += own * (scaled @ basis[place].T)
                shares[place, index] = own[:, 0]
        if not last:
            found = solved_rows(shares, basis @ basis.transpose(0, 2, 1), right, RIDGE)
    found, basis = _in_order(found, basis, counting.mean(axis=1))
    return Factors(found, basis / roots, shares.any(axis=0))


def of_all_rows(weights: np.ndarray, rows: int) -> np.ndarray:
    """Weights (V, N) of N rows, which may be given as (V,)."""
    return np.broadcast_to(weights.T, (rows, len(weights))).T


def _solved_basis(weights: np.ndarray, values: np.ndarray, counting: np.ndarray) -> np.ndarray:
    """The basis (K, D) that fits `values` (M, D) best from `weights` (M, K), rows counting (M, 1)."""
    turned = (counting * weights).T
    normal = (turned @ weights).astype(np.float64)
    normal += (1e-6 * np.trace(normal) / len(normal) + 1e-12) * np.eye(len(normal))
    return np.linalg.solve(normal, (turned @ values).astype(np.float64)).astype(np.float32)


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


def _in_order(weights: np.ndarray, basis: np.ndarray, view_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same product with orthogonal components in falling energy, and columns of weights with magnitude 1."""
    energy = np.einsum("v,vkd,vld->kl", view_weights, basis, basis, optimize=True).astype(np.float64)
    spread = (weights.T @ weights).astype(np.float64)
    # Both sums are made diagonal at once: with energy = R R', the eigenvectors of R' spread R turn one into the identity.
    values, vectors = np.linalg.eigh(energy)
    values = np.maximum(values, max(1e-12 * values.max(initial=0.0), 1e-30))  # all of it may be 0
    root, inverse = vectors * np.sqrt(values), vectors / np.sqrt(values)
    _, turn = np.linalg.eigh(root.T @ spread @ root)
    turn = turn[:, ::-1]
    to_weights, to_basis = root @ turn, (inverse @ turn).T
    weights, basis = weights @ to_weights.astype(np.float32), np.einsum("jk,vkd->vjd", to_basis.astype(np.float32), basis)
    largest = np.abs(weights).max(axis=0, initial=0.0)
    largest[largest == 0.0] = 1.0
    return weights / largest, basis * largest[:, None]
