"""Emission of texels. It is subtracted from the captured radiance and added when decoding, independent of the lights."""

from collections.abc import Iterable

import numpy as np

MIN_EMISSION = 1e-3  # radiance; when no texel emits more, the level has no emission


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
