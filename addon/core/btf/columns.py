"""Alternating least squares where a view knows one number of a row (how much is covered, how far off a shadow is): see `alternation`.

With one column a view nothing is gained by going view by view; equations of many rows, or of all views, are products of whole matrices.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from ..parallel import mapped, slices
from ..progress import Progress, Steps
from .alternation import RIDGE, solved_basis

CHUNK = 4096  # rows at once

Found = TypeVar("Found")


class Columns(Protocol):
    """What V views know of N rows."""

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of views and of rows, V and N."""

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is known of some rows (V, M) and what it counts (V, M), 0 where it is not known; float32."""


@dataclass(frozen=True)
class HeldColumns:
    """What is known of some rows in memory: values (V, N) and what they count (V, N), float32; see `Columns.read`."""

    values: np.ndarray
    counting: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """V, N."""
        return self.values.shape

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Columns`."""
        return self.values[:, rows], self.counting[:, rows]


class ColumnAlternation:
    """See `alternation.Alternating`; D is 1. To be made by `column_alternation`."""

    def __init__(self, columns: Columns, known: np.ndarray, view_weights: np.ndarray) -> None:
        self._columns, self.known, self.view_weights = columns, known, view_weights
        self._views, self._rows = columns.shape

    def basis(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """See `alternation.Alternating`."""
        count = weights.shape[1]
        left, right = np.zeros((self._views, count * (count + 1) // 2)), np.zeros((self._views, count))

        def terms(rows: slice) -> tuple[np.ndarray, np.ndarray]:
            values, counting = self._columns.read(rows)
            return counting @ _squares(weights[rows]), (counting * values) @ weights[rows]

        for rows, (of_left, of_right) in _by_chunk(terms, self._rows):
            yield self._progress(rows)
            left += of_left
            right += of_right
        return solved_basis(_unfolded(left, count), right[..., None])

    def rows(self, basis: np.ndarray) -> Steps[np.ndarray]:
        """See `alternation.Alternating`."""
        flat = basis[..., 0]
        squares, count = _squares(flat), flat.shape[1]
        diagonal = self.view_weights @ (flat**2).sum(axis=1) / count
        padding = (diagonal / max(int(self.known.sum()), 1) or 1.0) * RIDGE * np.eye(count)

        def solved(rows: slice) -> np.ndarray:
            values, counting = self._columns.read(rows)
            left = _unfolded((counting.T @ squares).astype(np.float64), count) + padding
            return np.linalg.solve(left, ((counting * values).T @ flat)[..., None].astype(np.float64))[..., 0].astype(np.float32)

        found = [np.zeros((0, count), np.float32)]
        for rows, part in _by_chunk(solved, self._rows):
            yield self._progress(rows)
            found.append(part)
        return np.concatenate(found)

    def improved(self, weights: np.ndarray) -> Steps[np.ndarray]:
        """See `alternation.Alternating`."""
        basis = yield from self.basis(weights)
        return (yield from self.rows(basis))

    def _progress(self, rows: slice) -> Progress:
        return Progress(rows.start / self._rows, "Compressing")


def column_alternation(columns: Columns) -> Steps[ColumnAlternation]:
    """The alternation for `columns`, which are read once for it."""
    views, rows = columns.shape
    known, view_weights = np.zeros(rows, bool), np.zeros(views)
    for chunk, (_, counting) in _by_chunk(columns.read, rows):
        yield Progress(chunk.start / rows, "Compressing")
        known[chunk] = counting.any(axis=0)
        view_weights += counting.sum(axis=1, dtype=np.float64)
    return ColumnAlternation(columns, known, view_weights)


def _by_chunk(function: Callable[[slice], Found], rows: int) -> Iterator[tuple[slice, Found]]:
    """Runs of so many `rows`, and what `function` makes of each, on several cores."""
    chunks = slices(rows, CHUNK)
    return zip(chunks, mapped(function, chunks), strict=True)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Products of every two numbers of each of `vectors` (M, K), those of the upper triangle (M, K (K + 1) / 2)."""
    first, second = np.triu_indices(vectors.shape[1])
    return vectors[:, first] * vectors[:, second]


def _unfolded(triangles: np.ndarray, count: int) -> np.ndarray:
    """Symmetric matrices (M, K, K) of upper triangles (M, K (K + 1) / 2)."""
    first, second = np.triu_indices(count)
    places = np.empty((count, count), np.int64)
    places[first, second] = places[second, first] = np.arange(len(first))
    return triangles[:, places]
