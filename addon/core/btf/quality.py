"""How near the factors come to what was captured, by the number of components."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..parallel import mapped
from ..progress import Progress, Steps
from .alternation import ViewData, of_all_rows
from .factors import Factors

PEAK = 0.99  # quantile of the captured values that counts as white
SAMPLE = 8192  # texels, about


@dataclass(frozen=True)
class Fit:
    """rms: root of the mean squared error of `components` components, views and columns weighted. psnr: in decibels, under `peak`."""

    components: int
    rms: float
    psnr: float


def quality(
    views: Sequence[ViewData],
    factors: Factors,
    tints: np.ndarray,
    weights: np.ndarray,
    column_weights: np.ndarray,
    more: Callable[[int, np.ndarray], np.ndarray] | None = None,
) -> Steps[list[Fit]]:
    """One fit for every number of components from 0 on, of colours with their `tints` (N, 3), by an even sample of the texels. Noise of the
    capture counts as error.

    more: what is shown besides the factors' colours from a view, by its number, of some rows (M,): (M, D). weights: as for `factorise`.
    """
    counting = of_all_rows(weights, len(tints))
    stride = max(1, len(tints) // SAMPLE)
    columns = column_weights.astype(np.float32)

    def measured(place: int) -> tuple[np.ndarray, float, float]:
        """What a view adds to the squared errors (K + 1,), to the sum of the weights, and what it shows as white."""
        squares = np.zeros(factors.components + 1)
        index, values = views[place].read()
        chosen = index % stride == 0
        index, values = index[chosen], values[chosen]
        if len(index) == 0:
            return squares, 0.0, 0.0
        tint = np.tile(tints[index], (1, values.shape[1] // 3))
        rest = values if more is None else values - more(place, index)
        own = counting[place, index]
        for number in range(len(squares)):
            if number:
                rest = rest - tint * factors.part(index, place, number - 1)
            squares[number] = float(own @ (np.square(rest) @ columns).astype(np.float64))
        return squares, float(own.sum()) * float(column_weights.sum()), float(np.quantile(values, PEAK))

    squares, weight, peak = np.zeros(factors.components + 1), 0.0, 0.0
    for place, (part, share, white) in enumerate(mapped(measured, range(len(views)))):
        yield Progress(place / len(views), "Measuring")
        squares, weight, peak = squares + part, weight + share, max(peak, white)
    rms = np.sqrt(squares / max(weight, 1e-300))
    return [Fit(number, float(each), float(20.0 * np.log10(max(peak or 1.0, 1e-12) / max(each, 1e-12)))) for number, each in enumerate(rms)]
