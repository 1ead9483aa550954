"""Low-rank factors of a matrix that is known in part; see `alternation`.

(The paper compresses with local PCA after filling, section 5.2: `lpca`.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..progress import Steps, scaled
from .alternation import Alternating, Alternation, Sampled, ViewData, of_all_rows
from .columns import Columns, HeldColumns, column_alternation

PASSES = 8  # over a sample of rows, which are kept in memory
SAMPLE = 8192  # rows
FIRST, AGAIN, LAST = 0.3, 0.6, 0.85  # of the bar of `_found`


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

    def spread(self, rows: slice | np.ndarray) -> np.ndarray:
        """The weights (M, clusters * K) of some rows, 0 for the components of other clusters than their own."""
        return self.weights[rows]

    def part(self, rows: np.ndarray, view: int, number: int) -> np.ndarray:
        """What component `number` alone adds to the values (M, D) of `rows` (M,) in a view."""
        return self.weights[rows, number, None] * self.basis[view, number]


def factorise(
    views: Sequence[ViewData], rows: int, components: int, weights: np.ndarray, column_weights: np.ndarray, seed: int = 0
) -> Steps[Factors]:
    """Factors of the matrix that `views` know: a sample of its rows finds the basis, then all rows have their say.

    Args:
        weights: (V, N) what each row counts from each view, or (V,) for all rows alike. column_weights: (D,) what each column counts.
    """
    roots = np.sqrt(column_weights / column_weights.mean()).astype(np.float32)
    counting = of_all_rows((weights / weights.mean()).astype(np.float32), rows)
    chosen = _sample(rows)
    whole = Alternation(views, counting, roots)
    sampled = whole if len(chosen) == rows else Alternation([Sampled(view, chosen) for view in views], counting[:, chosen], roots)
    found = yield from _found(whole, sampled, len(chosen), components, seed)
    return replace(found, basis=found.basis / roots)


def factorise_columns(columns: Columns, components: int, seed: int = 0) -> Steps[Factors]:
    """The same of a matrix with one column a view, which say themselves what each row counts; D is 1."""
    chosen = _sample(columns.shape[1])
    whole = sampled = yield from scaled(column_alternation(columns), 0.0, 0.0)
    if len(chosen) < columns.shape[1]:
        sampled = yield from scaled(column_alternation(HeldColumns(*columns.read(chosen))), 0.0, 0.0)
    return (yield from _found(whole, sampled, len(chosen), components, seed))


def _sample(rows: int) -> np.ndarray:
    """The numbers (S,) of SAMPLE rows, ascending, or of all."""
    return np.unique(np.linspace(0, rows - 1, min(rows, SAMPLE)).round().astype(np.int64))


def _found(whole: Alternating, sampled: Alternating, rows: int, components: int, seed: int) -> Steps[Factors]:
    """Factors of `whole`, with a basis that is looked for in some `rows` of it first: `sampled`, or all of it."""
    found = np.random.default_rng(seed).standard_normal((rows, components)).astype(np.float32)
    found[:, 0] = 1.0
    for number in range(PASSES):
        found = yield from scaled(sampled.improved(found), FIRST * number / PASSES, FIRST * (number + 1) / PASSES)
    if sampled is not whole:
        basis = yield from scaled(sampled.basis(found), FIRST, FIRST)
        found = yield from scaled(whole.rows(basis), FIRST, AGAIN)
        found = yield from scaled(whole.improved(found), AGAIN, LAST)
    basis = yield from scaled(whole.basis(found), LAST, 1.0)
    return Factors(*_in_order(found, basis, whole.view_weights), whole.known)


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
