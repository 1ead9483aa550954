"""Pixels of photographs that show the background instead of the surface, by their color (Textures Revisited, section 4.1).

Where the registration is wrong by a few pixels, points near a silhouette lie in front of the background. Photographs are compared with the
color of the background after a median of 3 x 3 pixels and a Gaussian. Objects may have the same color, so pixels that the mesh covers
count only if they are connected to background outside of the mesh, and only as far as a wrong registration reaches.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter, generate_binary_structure

from ...geometry.lenses import PhotoCamera
from ...geometry.mesh import TriangleMesh
from ...imaging.raster import rasterize
from ..settings import PhotosSettings
from .photograph import Photograph


@dataclass(frozen=True)
class Tuning:
    """Numbers of the method. Deviations and thresholds are those of encoded colors, root mean square of the channels."""

    blur_pixels: float = 1.0  # standard deviation of the Gaussian
    mixed_pixels: int = 2  # width of what surrounds the background, where its colors are mixed with those of the object
    reach: float = 0.02  # how far background reaches into the mesh, relative to the longer side
    frame_fraction: float = 0.02  # width of the border that shows the color, relative to the shorter side
    min_frame_pixels: int = 100  # fewer pixels outside of the mesh show no color
    max_samples: int = 20_000  # pixels that the color is fitted to
    uniform_deviation: float = 0.06  # A uniform background deviates by less ...
    uniform_fraction: float = 0.8  # ... in this fraction of the border.
    similar_deviation: float = 0.12  # Pixels outside of the mesh that deviate by less refine the color.
    min_threshold: float = 0.02
    max_threshold: float = 0.12
    inlier_percentile: float = 95.0  # The threshold is this percentile of the deviations ...
    threshold_factor: float = 1.5  # ... times this factor.
    iterations: int = 15  # steps of reweighted least squares
    min_residual: float = 2e-3
    ridge: float = 1e-3  # regularization of the terms that vary, relative to the number of pixels


TUNING = Tuning()


def find_surface(photograph: Photograph, mesh: TriangleMesh, settings: PhotosSettings) -> np.ndarray | None:
    """Return the pixels (H, W) bool of a photograph of `mesh` that do not show the background, None if that excludes nothing, for instance
    because the border has no uniform color."""
    if settings.background == "none":
        return None
    background = find_background(photograph, find_covered(mesh, photograph.camera), settings)
    return ~binary_dilation(background, generate_binary_structure(2, 2), TUNING.mixed_pixels) if background.any() else None


def find_covered(mesh: TriangleMesh, camera: PhotoCamera) -> np.ndarray:
    """Return the pixels (H, W) bool of a photograph that `mesh` covers."""
    width, height = camera.lens.size
    positions, _, is_valid = camera.project(mesh.vertices)
    covered = np.zeros(height * width, bool)
    for _, pixels, _ in rasterize(positions[mesh.triangles[is_valid[mesh.triangles].all(axis=1)]], (width, height)):
        covered[pixels] = True
    return covered.reshape(height, width)


def find_background(photograph: Photograph, covered: np.ndarray, settings: PhotosSettings) -> np.ndarray:
    """Return the pixels (H, W) bool of the background, given those that the mesh covers (H, W) bool."""
    channels = [_smooth(photograph.pixels[..., channel]) for channel in range(3)]
    outside = ~covered if photograph.mask is None else ~covered & photograph.mask
    if settings.background == "color":
        colors = _constant(settings.background_color)
    else:
        frame = _sample(outside & _frame(covered.shape))
        if len(frame) < TUNING.min_frame_pixels:
            return np.zeros(covered.shape, bool)
        colors = _fit(channels, frame)
        deviations = _measure(channels, colors, frame)
        if settings.background == "auto" and np.mean(deviations < TUNING.uniform_deviation) < TUNING.uniform_fraction:
            return np.zeros(covered.shape, bool)
        around = _sample(outside)
        similar = around[_measure(channels, colors, around) < TUNING.similar_deviation]
        if len(similar) >= TUNING.min_frame_pixels:
            colors = _fit(channels, similar)
    threshold = settings.background_threshold or _choose_threshold(_measure(channels, colors, _sample(outside)))
    is_similar = _compare(channels, colors, threshold)
    reach = max(round(TUNING.reach * max(covered.shape)), 1)
    return binary_dilation(is_similar & ~covered, iterations=reach, mask=is_similar)


def _choose_threshold(deviations: np.ndarray) -> float:
    """Return the largest deviation of the background, given those of pixels outside of the mesh."""
    inner = deviations[deviations < TUNING.similar_deviation]
    if not len(inner):
        return TUNING.min_threshold
    threshold = TUNING.threshold_factor * np.percentile(inner, TUNING.inlier_percentile)
    return float(np.clip(threshold, TUNING.min_threshold, TUNING.max_threshold))


def _constant(color: np.ndarray | tuple) -> np.ndarray:
    """Return a uniform background. Colors of a background are coefficients (6, 3) of 1, x, y, x^2, x y, y^2, with x and y from -1 to 1 over
    the photograph."""
    return np.vstack([color, np.zeros((5, 3))])


def _axes(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return x (W,) and y (H,) of the centers of pixels."""
    return tuple(((2.0 * np.arange(length) + 1.0) / length - 1.0).astype(np.float32) for length in (shape[1], shape[0]))


def _terms_at(shape: tuple[int, int], pixels: np.ndarray) -> np.ndarray:
    """Return the terms (N, 6) at flat indices (N,)."""
    (all_x, all_y), (rows, columns) = _axes(shape), np.divmod(pixels, shape[1])
    x, y = all_x[columns], all_y[rows]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1).astype(np.float64)


def _values(channels: list[np.ndarray], pixels: np.ndarray) -> np.ndarray:
    """Return the encoded colors (N, 3) at flat indices (N,)."""
    return np.stack([channel.ravel()[pixels] for channel in channels], axis=1).astype(np.float64) * _scale(channels[0])


def _scale(channel: np.ndarray) -> float:
    return 1.0 / 255.0 if channel.dtype == np.uint8 else 1.0


def _fit(channels: list[np.ndarray], pixels: np.ndarray) -> np.ndarray:
    """Return the colors that fit most of the `pixels` (N,): sums of distances, which outliers influence little."""
    terms, values = _terms_at(channels[0].shape, pixels), _values(channels, pixels)
    colors = _constant(np.median(values, axis=0))
    ridge = TUNING.ridge * len(pixels) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    for _ in range(TUNING.iterations):
        weights = 1.0 / np.maximum(np.linalg.norm(values - terms @ colors, axis=1), TUNING.min_residual)
        weights /= weights.mean()
        weighted = terms * weights[:, None]
        colors = np.linalg.solve(weighted.T @ terms + ridge, weighted.T @ values)
    return colors


def _measure(channels: list[np.ndarray], colors: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the deviations (N,) of `pixels` (N,) from the colors of the background."""
    differences = _values(channels, pixels) - _terms_at(channels[0].shape, pixels) @ colors
    return np.sqrt(np.square(differences).mean(axis=1))


def _compare(channels: list[np.ndarray], colors: np.ndarray, threshold: float) -> np.ndarray:
    """Return which pixels (H, W) deviate by less than the threshold."""
    x, y = _axes(channels[0].shape)
    squares = np.zeros(channels[0].shape, np.float32)
    for channel, coefficients in zip(channels, colors.T.astype(np.float32), strict=True):
        expected = coefficients[0] + (coefficients[1] + coefficients[3] * x) * x
        expected = expected + ((coefficients[2] + coefficients[5] * y) * y)[:, None] + coefficients[4] * x * y[:, None]
        squares += np.square(channel * np.float32(_scale(channel)) - expected)
    return squares < 3.0 * threshold**2


def _frame(shape: tuple[int, int]) -> np.ndarray:
    """Return the pixels (H, W) bool along the border."""
    width = max(round(TUNING.frame_fraction * min(shape)), 2)
    frame = np.ones(shape, bool)
    frame[width:-width, width:-width] = False
    return frame


def _sample(mask: np.ndarray) -> np.ndarray:
    """Return flat indices (N,) of at most TUNING.max_samples pixels of a mask, in random order."""
    found = np.flatnonzero(mask)
    return found if len(found) <= TUNING.max_samples else np.random.default_rng(0).choice(found, TUNING.max_samples, replace=False)


def _smooth(channel: np.ndarray) -> np.ndarray:
    """Return a channel (H, W) after a median of 3 x 3 pixels and a Gaussian, in its dtype."""
    smooth = gaussian_filter(_median_3x3(channel).astype(np.float32), TUNING.blur_pixels)
    return np.rint(smooth).astype(np.uint8) if channel.dtype == np.uint8 else smooth


def _median_3x3(channel: np.ndarray) -> np.ndarray:
    """Return the medians (H, W) of 3 x 3 pixels: that of the largest minimum, the median median and the smallest maximum of the columns,
    which takes comparisons of whole images only."""
    padded = np.pad(channel, 1, mode="edge")
    low, median, high = _sort(padded[:-2], padded[1:-1], padded[2:])
    columns = [[each[:, start : start + channel.shape[1]] for start in range(3)] for each in (low, median, high)]
    return _sort(reduce(np.maximum, columns[0]), _sort(*columns[1])[1], reduce(np.minimum, columns[2]))[1]


def _sort(first: np.ndarray, second: np.ndarray, third: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the smallest, median and largest values of three images."""
    low, high = np.minimum(first, second), np.maximum(first, second)
    return np.minimum(low, third), np.maximum(low, np.minimum(high, third)), np.maximum(high, third)
