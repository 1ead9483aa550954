"""How near the factors come to what was captured, by the number of components."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

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
    squares, weight = np.zeros(factors.components + 1), 0.0
    counting = of_all_rows(weights, len(tints))
    stride = max(1, len(tints) // SAMPLE)
    peaks, columns = [], column_weights.astype(np.float32)
    for place, view in enumerate(views):
        yield Progress(place / len(views), "Measuring")
        index, values = view.read()
        chosen = index % stride == 0
        index, values = index[chosen], values[chosen]
        if len(index) == 0:
            continue
        tint = np.tile(tints[index], (1, values.shape[1] // 3))
        peaks.append(np.quantile(values, PEAK))
        rest = values if more is None else values - more(place, index)
        own = counting[place, index]
        weight += float(own.sum()) * float(column_weights.sum())
        for number in range(len(squares)):
            if number:
                rest = rest - tint * factors.part(index, place, number - 1)
            squares[number] += float(own @ (np.square(rest) @ columns).astype(np.float64))
    rms = np.sqrt(squares / max(weight, 1e-300))
    peak = max(peaks, default=1.0)
    return [Fit(number, float(each), float(20.0 * np.log10(max(peak, 1e-12) / max(each, 1e-12)))) for number, each in enumerate(rms)]
