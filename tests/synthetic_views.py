"""Synthetic datasets of partially known matrices, for the tests of fits and factorizations."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class InMemoryView:
    """The known rows `rows` (M,) of one view and their `values` (M, ...)."""

    rows: np.ndarray
    values: np.ndarray

    def read(self):
        """Return rows and values; see `ViewData`."""
        return self.rows, self.values.reshape(len(self.rows), -1)


def sample_views(values: np.ndarray, fraction: float) -> list[InMemoryView]:
    """Return one view per entry of `values` (V, N, D); each knows its own random `fraction` of the rows."""
    random = np.random.default_rng(5)
    known_rows = [np.flatnonzero(random.random(values.shape[1]) < fraction) for _ in values]
    return [InMemoryView(rows, values[view, rows]) for view, rows in enumerate(known_rows)]
