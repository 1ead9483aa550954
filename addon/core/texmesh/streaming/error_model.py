"""How errors of the mesh and of the textures combine to one."""

from dataclasses import dataclass

import numpy as np

MIN_EXPONENT, MAX_EXPONENT = 1.0, 8.0


@dataclass(frozen=True)
class ErrorModel:
    """Predicted mean FLIP errors: of each level, coarsest first, with whole textures, of each state of the textures with the finest level,
    and the exponent with which both combine. Errors are 0 to 1 and never rise."""

    levels: tuple[float, ...]
    states: tuple[float, ...]
    exponent: float

    def tabulate(self) -> tuple[tuple[float, ...], ...]:
        """Return the errors of each level with each state."""
        errors = combine_errors(np.array(self.levels)[:, None], np.array(self.states)[None], self.exponent)
        return tuple(tuple(row) for row in np.minimum(errors, 1.0).tolist())


def combine_errors(first: np.ndarray | float, second: np.ndarray | float, exponent: float) -> np.ndarray:
    """Return the error of two independent causes: the sum with `exponent` 1, the larger one with a large exponent."""
    largest = np.maximum(np.maximum(first, second), 1e-12)
    return largest * ((first / largest) ** exponent + (second / largest) ** exponent) ** (1.0 / exponent)
