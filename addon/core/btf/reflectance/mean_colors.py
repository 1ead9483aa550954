"""Mean colors of texels over all views: chromaticity and emission.

Colors are divided by the chromaticity before they are factorized, so that the residual depends on view and light alone. Emission is
subtracted from the captured radiance and added when decoding, independent of the lights.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps
from ..factorization.als import ViewData, split_lights

MIN_CHROMATICITY = 1e-3  # Division by a smaller value would amplify noise.
MIN_EMISSION = 1e-3  # Radiance; when no texel emits more, the level has no emission.


def compute_chromaticity(
    views: Sequence[ViewData], row_count: int, view_weights: np.ndarray, light_weights: np.ndarray
) -> Steps[np.ndarray]:
    """Return the weighted mean color (N, 3) float32 of N = `row_count` texels over all views and lights, divided by its mean channel; 1
    for unknown texels.

    The columns of `views` are light by light, three channels each. view_weights: (V,). light_weights: (L,).
    """
    total = np.zeros((row_count, 3))
    float32_weights = light_weights.astype(np.float32)

    def sum_lights(view: ViewData) -> tuple[np.ndarray, np.ndarray]:
        rows, values = view.read()
        return rows, float32_weights @ split_lights(values)

    for index, (rows, colors) in enumerate(map_ordered(sum_lights, views)):
        yield Progress(index / len(views), "Computing chromaticity")
        total[rows] += view_weights[index] * colors
    mean = total.mean(axis=1, keepdims=True)
    chromaticity = np.where(mean > 0.0, total / np.where(mean > 0.0, mean, 1.0), 1.0)
    return np.maximum(chromaticity, MIN_CHROMATICITY).astype(np.float32)


def mean_emission(views: Iterable[tuple[np.ndarray, np.ndarray]], weights: np.ndarray) -> np.ndarray | None:
    """Return the weighted mean emission (N, 3) float32 over all views; None without emission.

    Args:
        views: texels (M,) and their emission (M, 3) in each view. weights: (V, N) weight of each texel in each view.
    """
    total, total_weights = np.zeros((weights.shape[1], 3)), np.zeros((weights.shape[1], 1))
    for (rows, emission), view_weights in zip(views, weights, strict=True):
        total[rows] += view_weights[rows, None] * emission
        total_weights[rows] += view_weights[rows, None]
    mean = np.maximum(total / np.maximum(total_weights, 1e-12), 0.0)
    return mean.astype(np.float32) if mean.max(initial=0.0) > MIN_EMISSION else None
