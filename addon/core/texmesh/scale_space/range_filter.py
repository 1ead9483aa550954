"""Gaussian filters of range images and zero crossings of their Laplacian (equations 1 to 5 of the TexMesh paper)."""

import numpy as np
from scipy.ndimage import convolve1d

WINDOW = 1.4  # half the side of the window relative to the standard deviation (section II.A)
MIN_WEIGHT = 1e-9  # of known samples in a window


class RangeFilter:
    """Filters an image whose columns wrap and whose unknown samples and surroundings have no weight.

    The standard deviation is in mean samples: `phi` and `psi` are the squared distances between samples along columns and rows, relative to
    a mean sample (equation 4).
    """

    def __init__(self, ranges: np.ndarray, is_known: np.ndarray, phi: float = 1.0, psi: float = 1.0) -> None:
        """ranges: (rows, columns). is_known: (rows, columns) bool."""
        self._sums, self._weights = np.where(is_known, ranges, 0.0), is_known.astype(np.float64)
        self._steps = np.sqrt(psi), np.sqrt(phi)

    def smooth(self, sigma: float) -> np.ndarray:
        """Return the smoothed image (rows, columns), by two passes of one-dimensional filters; 0 where no known sample is in the window."""
        if sigma == 0.0:
            return self._sums
        kernels = [_gaussian(sigma, step) for step in self._steps]
        weights = _convolve(self._weights, *kernels)
        return np.where(weights > MIN_WEIGHT, _convolve(self._sums, *kernels) / np.maximum(weights, MIN_WEIGHT), 0.0)

    def laplacian(self, sigma: float) -> np.ndarray:
        """Return the Laplacian of Gaussian (rows, columns), times the squared standard deviation. A window with unknown samples is
        completed with the smoothed value of its center."""
        (gaussian_y, second_y), (gaussian_x, second_x) = ((_gaussian(sigma, step), _second_derivative(sigma, step)) for step in self._steps)
        response, leak = (
            _convolve(image, second_y, gaussian_x) + _convolve(image, gaussian_y, second_x) for image in (self._sums, self._weights)
        )
        return sigma**2 * (response - leak * self.smooth(sigma))


def find_zero_crossings(values: np.ndarray, is_known: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels (N,), row by row, at sign changes of `values` (rows, columns) between known neighbors, those nearer to zero, and
    the strengths (N,): the largest difference between the neighbors, above `noise`. Columns wrap."""
    strengths = np.zeros(values.shape)
    for axis in (0, 1):
        neighbor, neighbor_known = np.roll(values, -1, axis=axis), np.roll(is_known, -1, axis=axis)
        difference = np.abs(values - neighbor)
        is_crossing = ((values < 0.0) != (neighbor < 0.0)) & is_known & neighbor_known & (difference > noise)
        if axis == 0:
            is_crossing[-1] = False
        here = is_crossing & (np.abs(values) <= np.abs(neighbor))
        there = np.roll(is_crossing & (np.abs(neighbor) <= np.abs(values)), 1, axis=axis)
        strengths = np.maximum(strengths, np.maximum(difference * here, np.roll(difference, 1, axis=axis) * there))
    found = np.flatnonzero(strengths)
    return found, strengths.ravel()[found]


def _distances(sigma: float, step: float, least: int) -> np.ndarray:
    """Return the distances (2 t + 1,) of samples from the center of a window, in mean samples; t is at least `least`."""
    half = max(int(WINDOW * sigma / step + 0.5), least)
    return step * np.arange(-half, half + 1)


def _gaussian(sigma: float, step: float, least: int = 1) -> np.ndarray:
    weights = np.exp(-0.5 * (_distances(sigma, step, least) / sigma) ** 2)
    return weights / weights.sum()


def _second_derivative(sigma: float, step: float) -> np.ndarray:
    """Return the second derivative of a Gaussian, corrected within its window to be exact for parabolas."""
    distances = _distances(sigma, step, 1)
    squared = (distances / sigma) ** 2
    weights = (squared - 1.0) * np.exp(-0.5 * squared)
    weights -= weights.mean()
    return weights * (2.0 / (weights @ distances**2))


def _convolve(image: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return convolve1d(convolve1d(image, columns, axis=1, mode="wrap"), rows, axis=0, mode="constant")
