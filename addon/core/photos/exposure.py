"""Gains per photograph and channel that make photographs of the same surface equally bright.

The logarithms of linear colors of points that several photographs see are compared; robust least squares (iterative reweighting with the
weights of Huber) finds the gains. Their mean logarithm is zero, so that the texture as a whole keeps its brightness.
"""

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import find_group_medians
from ..imaging.colors import decode_signed_srgb
from .observations import Observations

MIN_LINEAR, MAX_ENCODED = 0.01, 0.97  # darker colors are noise, brighter ones are clipped
HUBER = 0.1  # of a logarithm: larger differences are outliers
MAX_PER_POINT = 8  # observations of a point that are compared, chosen at random: the cost grows with the square
ITERATIONS = 20
TOLERANCE = 1e-4  # of logarithmic gains
REGULARIZATION = 1e-3  # relative to the number of comparisons; photographs without overlap keep their exposure


def estimate_gains(observed: Observations, count: int, weights: np.ndarray | None = None) -> np.ndarray:
    """Return gains (K, 3) for `count` photographs; `weights` (N,) of the observations are 1 by default."""
    usable, given = choose_observations(observed, weights)
    points, photographs = observed.points[usable], observed.photographs[usable]
    logarithms = np.log(np.maximum(decode_signed_srgb(observed.colors[usable]), MIN_LINEAR))
    rows = np.unique(points, return_inverse=True)[1]
    gains = np.zeros((count, 3))
    for channel in range(3):
        for _ in range(ITERATIONS):
            adjusted = logarithms[:, channel] + gains[photographs, channel]
            residuals = adjusted - find_group_medians(points, adjusted[:, None])[:, 0]
            robust = given * np.minimum(1.0, HUBER / np.maximum(np.abs(residuals), 1e-9))
            previous = gains[:, channel].copy()
            gains[:, channel] = _solve(rows, photographs, logarithms[:, channel], robust, count)
            if np.abs(gains[:, channel] - previous).max() < TOLERANCE:
                break
    return np.exp(gains)


def choose_observations(observed: Observations, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return which observations (N,) bool are compared, not clipped and few of each point, and the weights (M,) of those."""
    usable = (observed.colors.max(axis=1) < MAX_ENCODED) & (True if weights is None else weights > 0.0)
    given = np.ones(len(observed.points)) if weights is None else weights
    usable &= _rank(observed.points, usable) < MAX_PER_POINT
    return usable, given[usable]


def _rank(points: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the place (N,) of each observation among the usable ones of its point, in random order."""
    order = np.lexsort((np.random.default_rng(0).random(len(points)), ~usable, points))
    starts = np.searchsorted(points, points)  # points ascend
    ranks = np.empty(len(points), np.int64)
    ranks[order] = np.arange(len(points)) - starts[order]
    return ranks


def _solve(rows: np.ndarray, photographs: np.ndarray, values: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """Return the logarithmic gains (K,) that minimize the weighted variance of each point, with the index `rows` (N,), over the
    photographs."""
    totals = np.bincount(rows, weights)
    matrix = csr_matrix((weights, (rows, photographs)), shape=(len(totals), count))
    normalized = csr_matrix((weights / np.maximum(totals, 1e-30)[rows], (rows, photographs)), shape=(len(totals), count))
    means = np.bincount(rows, weights * values) / np.maximum(totals, 1e-30)
    right_side = -np.bincount(photographs, weights * (values - means[rows]), count)
    scale = max(float(weights.sum()), 1.0)
    variance = np.diag(np.bincount(photographs, weights, count)) - (matrix.T @ normalized).toarray()
    return np.linalg.solve(variance + REGULARIZATION * scale / count * np.eye(count) + scale / count**2, right_side)
