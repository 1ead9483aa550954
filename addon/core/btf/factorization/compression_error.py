"""Compression error against the captured values, by number of components."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...arrays import TINY
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps
from .als import ViewMatrix
from .factors import Factors

PEAK_QUANTILE = 0.99  # This quantile of the captured values is the peak signal of the PSNR.
SAMPLE_TEXELS = 8192  # About.


@dataclass(frozen=True)
class ComponentError:
    """Error with `components` components. rms: root mean square, with the weights of views and columns. psnr: in decibels."""

    components: int
    rms: float
    psnr: float


def error_by_components(
    matrix: ViewMatrix,
    factors: Factors,
    chromaticity: np.ndarray,
    offset: Callable[[int, np.ndarray], np.ndarray] | None = None,
) -> Steps[list[ComponentError]]:
    """Measure the error of `factors` times `chromaticity` (N, 3) for every number of components from 0 on, on an even sample of the texels.
    Noise in the captured values of `matrix` counts as error.

    offset: function of a view and rows (M,) that returns values (M, D) to add to those of the factors.
    """
    row_weights = matrix.row_weights
    stride = max(1, matrix.row_count // SAMPLE_TEXELS)
    column_weights = matrix.column_weights.astype(np.float32)

    def measure(view: int) -> tuple[np.ndarray, float, float]:
        """Return the weighted squared errors (K + 1,) of a view, its sum of weights, and its peak."""
        squared_errors = np.zeros(factors.components + 1)
        rows, values = matrix.views[view].read()
        is_sampled = rows % stride == 0
        rows, values = rows[is_sampled], values[is_sampled]
        if len(rows) == 0:
            return squared_errors, 0.0, 0.0
        factor = np.tile(chromaticity[rows], (1, values.shape[1] // 3))
        residual = values if offset is None else values - offset(view, rows)
        weights = row_weights[view, rows]
        for count in range(len(squared_errors)):
            if count:
                residual = residual - factor * factors.component_contribution(rows, view, count - 1)
            squared_errors[count] = float(weights @ (np.square(residual) @ column_weights).astype(np.float64))
        return squared_errors, float(weights.sum()) * float(matrix.column_weights.sum()), float(np.quantile(values, PEAK_QUANTILE))

    squared_errors, total_weight, peak = np.zeros(factors.components + 1), 0.0, 0.0
    for view, (view_errors, view_weight, view_peak) in enumerate(map_ordered(measure, range(len(matrix.views)))):
        yield Progress(view / len(matrix.views), "Measuring")
        squared_errors, total_weight, peak = squared_errors + view_errors, total_weight + view_weight, max(peak, view_peak)
    rms = np.sqrt(squared_errors / max(total_weight, TINY))
    return [
        ComponentError(count, float(error), float(20.0 * np.log10(max(peak or 1.0, 1e-12) / max(error, 1e-12))))
        for count, error in enumerate(rms)
    ]
