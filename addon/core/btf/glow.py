"""What texels shine by themselves, whatever lamps there are: taken out of what is lit, and added as it is."""

from collections.abc import Iterable

import numpy as np

LEAST = 1e-3  # radiance: where nothing shines more, nothing does


def mean_glow(views: Iterable[tuple[np.ndarray, np.ndarray]], weights: np.ndarray) -> np.ndarray | None:
    """What texels shine (N, 3) float32 in the mean over all views; None where nothing does.

    Args:
        views: of each, texels (M,) and what they shine (M, 3). weights: (V, N), what each texel counts from each view.
    """
    total, counted = np.zeros((weights.shape[1], 3)), np.zeros((weights.shape[1], 1))
    for (index, glow), counts in zip(views, weights, strict=True):
        total[index] += counts[index, None] * glow
        counted[index] += counts[index, None]
    mean = np.maximum(total / np.maximum(counted, 1e-12), 0.0)
    return mean.astype(np.float32) if mean.max(initial=0.0) > LEAST else None
