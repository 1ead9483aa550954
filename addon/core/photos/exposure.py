"""Gains per photograph and channel that make photographs of the same surface equally bright.

The logarithms of linear colors of points that several photographs see are compared; robust least squares (iterative reweighting with the
weights of Huber) finds the gains. Their mean logarithm is zero, so that the texture as a whole keeps its brightness.
"""

import numpy as np

SAMPLES = 20_000
MIN_LINEAR, MAX_ENCODED = 0.01, 0.97  # darker colors are noise, brighter ones are clipped
HUBER = 0.1  # of a logarithm: larger differences are outliers
ITERATIONS = 20
REGULARIZATION = 1e-3  # relative to the number of comparisons; photographs without overlap keep their exposure


def estimate_gains(linear: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Return gains (K, 3) for K photographs.

    linear: (K, S, 3) linear colors of S points. visible: (K, S) bool, where they may be compared.
    """
    count = len(linear)
    compared = visible.sum(axis=0) > 1
    linear, visible = linear[:, compared], visible[:, compared]
    logarithms = np.log(np.maximum(linear, MIN_LINEAR))
    gains = np.zeros((count, 3))
    for channel in range(3):
        values = logarithms[..., channel]
        for _ in range(ITERATIONS):
            adjusted = np.where(visible, values + gains[:, channel, None], np.nan)
            center = np.nanmedian(adjusted, axis=0)
            residuals = np.nan_to_num(adjusted - center)
            weights = visible * np.minimum(1.0, HUBER / np.maximum(np.abs(residuals), 1e-9))
            gains[:, channel] = _solve(values, weights)
    return np.exp(gains)


def _solve(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the logarithmic gains (K,) that minimize the weighted variance of each point over the photographs."""
    totals = weights.sum(axis=0)
    used = totals > 0.0
    weights, values, totals = weights[:, used], values[:, used], totals[used]
    normalized = weights / totals
    matrix = np.diag(weights.sum(axis=1)) - weights @ normalized.T
    means = (normalized * values).sum(axis=0)
    right_side = -(weights * (values - means)).sum(axis=1)
    scale = max(float(weights.sum()), 1.0)
    regular = matrix + REGULARIZATION * scale / len(values) * np.eye(len(values)) + scale / len(values) ** 2
    return np.linalg.solve(regular, right_side)
