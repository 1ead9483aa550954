"""What views know of a matrix, made by hand, for the tests of what factorises it."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Known:
    """What one view knows: rows `index` (M,) and their `values` (M, ...)."""

    index: np.ndarray
    values: np.ndarray

    def read(self):
        """See `ViewData`."""
        return self.index, self.values.reshape(len(self.index), -1)


def seen(values: np.ndarray, share: float) -> list[Known]:
    """Views that know a `share` of the rows of `values` (V, N, D), each another one."""
    random = np.random.default_rng(5)
    indices = [np.flatnonzero(random.random(values.shape[1]) < share) for _ in values]
    return [Known(index, values[view, index]) for view, index in enumerate(indices)]
