"""Scale space of the range image of a mesh, the method of the TexMesh paper (sections II and III.A).

A range image is the distance R of the surface from an axis, by angle around the axis and height (section II.B).
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d, minimum_filter

from ...errors import GeometryError
from ...geometry.mesh import scaled_normals
from ...imaging.raster import rasterize
from ...jobs.progress import Progress, Steps
from ..settings import AnalysisSettings
from ..textured_mesh import TexturedMesh
from .features import SCALES, LastFeatures, ScaleMap

MIN_COLUMNS, MIN_ROWS = 8, 4
MAX_COLUMNS = MAX_ROWS = 1 << 13


@dataclass(frozen=True)
class Tuning:
    """Numbers of the method."""

    max_turn: float = 0.5 * np.pi  # A triangle that turns farther around the axis is next to it or around it.
    min_facing: float = 0.05  # Cosine between the normal and the direction away from the axis; below, a triangle is seen edge-on.
    min_extent: float = 1e-9  # In height, relative to the largest.
    layer_tolerance: float = 1.0  # Samples between a point and the surface around its pixel.
    rounding: float = 1e-9  # Differences of the Laplacian below this fraction of the largest range owe their sign to rounding.
    search_steps: int = 20  # Bisections of the largest standard deviation.
    min_samples: int = 16
    min_loss: float = 0.0005  # A loss of this fraction of the area is worth a sentence.
    window: float = 1.4  # Half the side of the window relative to the standard deviation (section II.A).
    min_weight: float = 1e-9  # A window with less weight of known samples is unknown.


TUNING = Tuning()


@dataclass(frozen=True)
class RangeImage:
    """Distances of the outermost surface from an axis, by angle (columns, wrapped) and height (rows, from the bottom).

    Attributes:
        ranges: (rows, columns) float64, 0 in holes.
        is_known: (rows, columns) bool.
        column_length, row_length: distance between samples, at the mean radius and along the axis.
        pixels: (V,) int64, the pixel of each vertex, row by row.
        is_seen: (V,) bool: whether the vertex is on the surface that its pixel shows.
        hidden, edge_on: fractions of the area that are behind the outermost surface, and edge-on to the axis, such as caps.
    """

    ranges: np.ndarray
    is_known: np.ndarray
    column_length: float
    row_length: float
    pixels: np.ndarray
    is_seen: np.ndarray
    hidden: float
    edge_on: float


def build_range_image(vertices: np.ndarray, triangles: np.ndarray, axis: int) -> RangeImage:
    """Return the range image about the axis through the center of the bounding box. vertices: (V, 3). axis: 0 to 2 for X to Z.

    There are about as many pixels as vertices; columns and rows follow from the extent of the edges in both directions.
    """
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    points = np.roll(vertices - center, 2 - axis, axis=1)
    centroids = points[triangles].mean(axis=1)
    normals = scaled_normals(points[triangles])
    areas = np.linalg.norm(normals, axis=1)
    facing = np.abs(np.einsum("ij,ij->i", normals[:, :2], centroids[:, :2]))
    corner_angles = _unwrap(np.arctan2(points[:, 1], points[:, 0])[triangles])
    is_drawn = (np.ptp(corner_angles, axis=1) < TUNING.max_turn) & (facing > TUNING.min_facing * areas * np.hypot(*centroids[:, :2].T))

    low, extent = points[:, 2].min(), max(float(np.ptp(points[:, 2])), TUNING.min_extent * float(np.abs(points).max()))
    size = _choose_size(corner_angles[is_drawn], points[triangles[is_drawn], 2], extent, len(vertices))
    scale = np.array([size[0] / (2.0 * np.pi), size[1] / extent])
    corners = np.stack([(corner_angles + np.pi) * scale[0], (points[triangles, 2] - low) * scale[1]], axis=2)
    ranges = _draw_ranges(points[triangles[is_drawn]], corners[is_drawn], normals[is_drawn], size, low, 1.0 / scale[1])
    is_known = ranges > 0.0

    radius = float(ranges[is_known].mean()) if is_known.any() else 0.0
    lengths = 2.0 * np.pi * radius / size[0], extent / size[1]
    least = np.where(is_known, ranges, np.inf)
    least = minimum_filter(least, 3, mode=("nearest", "wrap")) - TUNING.layer_tolerance * np.sqrt(lengths[0] * lengths[1])
    least = np.where(is_known, least, np.inf).ravel()
    pixels = _pixels_of(points, scale, size, low)
    is_shown = np.hypot(*centroids[:, :2].T) >= least[_pixels_of(centroids, scale, size, low)]
    return RangeImage(
        ranges=ranges,
        is_known=is_known,
        column_length=lengths[0],
        row_length=lengths[1],
        pixels=pixels,
        is_seen=np.hypot(*points[:, :2].T) >= least[pixels],
        hidden=float(areas[is_drawn & ~is_shown].sum() / areas.sum()),
        edge_on=float(areas[~is_drawn].sum() / areas.sum()),
    )


def _unwrap(angles: np.ndarray) -> np.ndarray:
    """Return `angles` (T, 3) plus multiples of a turn, so that each is within half a turn of the first corner's."""
    return angles[:, :1] + np.remainder(angles - angles[:, :1] + np.pi, 2.0 * np.pi) - np.pi


def _choose_size(angles: np.ndarray, heights: np.ndarray, extent: float, count: int) -> tuple[int, int]:
    """Return columns and rows for `count` samples of triangles at `angles` and `heights` (T, 3) of a mesh with this `extent` in height."""
    turn, rise = (
        float(np.sqrt(np.mean((values - np.roll(values, 1, axis=1)) ** 2))) if len(values) else 0.0 for values in (angles, heights)
    )
    ratio = (2.0 * np.pi * rise) / (extent * turn) if turn > 0.0 and rise > 0.0 else 1.0
    columns = int(np.clip(np.rint(np.sqrt(count * ratio)), MIN_COLUMNS, MAX_COLUMNS))
    return columns, int(np.clip(np.rint(count / columns), MIN_ROWS, MAX_ROWS))


def _draw_ranges(
    triangles: np.ndarray, corners: np.ndarray, normals: np.ndarray, size: tuple[int, int], low: float, row_height: float
) -> np.ndarray:
    """Return the largest distance from the axis (rows, columns) in each pixel, 0 where there is none.

    triangles: (T, 3, 3) corner positions, the axis being Z. corners: (T, 3, 2) the same in pixels. normals: (T, 3). low, row_height: of the
    rows.
    """
    columns, rows = size
    ranges = np.zeros(columns * rows)
    shifted = corners.copy()
    shifted[..., 0] -= columns * np.floor(corners[..., 0].min(axis=1, keepdims=True) / columns)
    offsets = np.einsum("ij,ij->i", normals, triangles[:, 0])
    limits = np.hypot(triangles[..., 0], triangles[..., 1]).max(axis=1)
    for found, pixels, _ in rasterize(shifted, (2 * columns, rows)):
        row, column = pixels // (2 * columns), pixels % (2 * columns) % columns
        angle = (column + 0.5) * (2.0 * np.pi / columns) - np.pi
        height = low + (row + 0.5) * row_height
        along = normals[found, 0] * np.cos(angle) + normals[found, 1] * np.sin(angle)
        distance = (offsets[found] - normals[found, 2] * height) / np.where(along != 0.0, along, 1.0)
        np.maximum.at(ranges, row * columns + column, np.clip(distance, 0.0, limits[found]))
    return ranges.reshape(rows, columns)


def _pixels_of(points: np.ndarray, scale: np.ndarray, size: tuple[int, int], low: float) -> np.ndarray:
    """Return the pixels (N,) of `points` (N, 3), row by row; scale: pixels per radian and per unit of height."""
    columns, rows = size
    column = np.floor((np.arctan2(points[:, 1], points[:, 0]) + np.pi) * scale[0]).astype(np.int64) % columns
    row = np.clip(np.floor((points[:, 2] - low) * scale[1]).astype(np.int64), 0, rows - 1)
    return row * columns + column


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
        return np.where(weights > TUNING.min_weight, _convolve(self._sums, *kernels) / np.maximum(weights, TUNING.min_weight), 0.0)

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
    half = max(int(TUNING.window * sigma / step + 0.5), least)
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
    if image.is_known.sum() < TUNING.min_samples:
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
            crossings = find_zero_crossings(filtering.laplacian(sigma), image.is_known, TUNING.rounding * float(image.ranges.max()))
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
    for _ in range(TUNING.search_steps):
        center = 0.5 * (low + high)
        low, high = (low, center) if _measure_span(filtering, image, center) < target else (center, high)
    return high


def _measure_span(filtering: RangeFilter, image: RangeImage, sigma: float) -> float:
    """Return the largest minus the smallest filtered value (Figure 10)."""
    return float(np.ptp(filtering.smooth(sigma)[image.is_known]))


def _describe_losses(image: RangeImage) -> str:
    if image.hidden + image.edge_on < TUNING.min_loss:
        return ""
    return (
        f"{100.0 * (image.hidden + image.edge_on):.1f}% of the area is not in the range image: {100.0 * image.hidden:.1f}% is behind other "
        f"parts, {100.0 * image.edge_on:.1f}% is edge-on to the axis, such as caps."
    )
