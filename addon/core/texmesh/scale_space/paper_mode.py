"""Scale space of the range image of a mesh, the method of the TexMesh paper (sections II and III.A)."""

import numpy as np
from scipy.ndimage import convolve1d

from ...errors import GeometryError
from ...jobs.progress import Progress, Steps
from ..settings import AnalysisSettings
from ..textured_mesh import TexturedMesh
from .features import SCALES, LastFeatures, ScaleMap
from .range_image import RangeImage, build_range_image

ROUNDING = 1e-9  # of the largest range: smaller differences of the Laplacian owe their sign to rounding
SEARCH_STEPS = 20  # bisections of the largest standard deviation
MIN_SAMPLES = 16
MIN_LOSS = 0.0005  # of the area, that is worth a sentence
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


def analyze_range_image(mesh: TexturedMesh, settings: AnalysisSettings) -> Steps[ScaleMap]:
    """Return the scale map of `mesh` by filters of its range image. The last scale of a vertex is that of its pixel, 0 if its pixel shows
    another part of the surface.

    Raises:
        GeometryError: next to nothing of the surface faces the axis.
    """
    yield Progress(0.0, "Building the range image")
    image = build_range_image(mesh.vertices, mesh.triangles, "xyz".index(settings.axis))
    if image.is_known.sum() < MIN_SAMPLES:
        raise GeometryError(
            f"The surface is edge-on to the {settings.axis.upper()} axis, so that it has no range image; choose another axis or analysis."
        )
    sample = float(np.sqrt(image.column_length * image.row_length))
    filtering = RangeFilter(image.ranges, image.is_known, phi=(image.column_length / sample) ** 2, psi=(image.row_length / sample) ** 2)
    limit = 0.5 * max(image.ranges.shape[1] * image.column_length, image.ranges.shape[0] * image.row_length) / sample
    sigmas = np.linspace(0.0, _search_last_sigma(filtering, image, settings.convergence, limit), SCALES)

    pixels = LastFeatures(np.zeros(image.ranges.size))
    spans = []
    for scale, sigma in enumerate(sigmas):
        yield Progress(0.1 + 0.85 * scale / SCALES, f"Filtering, scale {scale} of {SCALES - 1}")
        spans.append(_measure_span(filtering, image, sigma))
        if scale:
            crossings = find_zero_crossings(filtering.laplacian(sigma), image.is_known, ROUNDING * float(image.ranges.max()))
            pixels.add(scale, *crossings)
    features = LastFeatures(np.where(image.is_seen, pixels.strengths[image.pixels], 0.0))
    features.last_scales = np.where(image.is_seen, pixels.last_scales[image.pixels], 0).astype(np.int8)
    return features.to_scale_map(sigmas * sample, np.array(spans) / max(spans[0], np.finfo(float).tiny), _describe_losses(image))


def _search_last_sigma(filtering: RangeFilter, image: RangeImage, convergence: float, limit: float) -> float:
    """Return the standard deviation, at most `limit`, in mean samples, at which the range of the filtered image falls to the fraction
    `convergence` (section IV)."""
    target = convergence * _measure_span(filtering, image, 0.0)
    low, high = 0.0, limit
    if _measure_span(filtering, image, high) >= target:
        return high
    for _ in range(SEARCH_STEPS):
        center = 0.5 * (low + high)
        low, high = (low, center) if _measure_span(filtering, image, center) < target else (center, high)
    return high


def _measure_span(filtering: RangeFilter, image: RangeImage, sigma: float) -> float:
    """Return the largest minus the smallest filtered value (Figure 10)."""
    return float(np.ptp(filtering.smooth(sigma)[image.is_known]))


def _describe_losses(image: RangeImage) -> str:
    if image.hidden + image.edge_on < MIN_LOSS:
        return ""
    return (
        f"{100.0 * (image.hidden + image.edge_on):.1f}% of the area is not in the range image: {100.0 * image.hidden:.1f}% is behind other "
        f"parts, {100.0 * image.edge_on:.1f}% is edge-on to the axis, such as caps."
    )
