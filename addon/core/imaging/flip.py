"""LDR-FLIP: the error that a viewer perceives when two images are shown alternately in the same place.

P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild: FLIP: A Difference Evaluator for Alternating Images,
2020. All constants are those of the authors' program. Their package flip-evaluator is compiled for each platform and version of Python, and
filters both images in every comparison; here an image that is compared with many others is filtered once. Tests compare both.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import ImageError, SettingsError
from .colors import decode_signed_srgb

DEFAULT_PIXELS_PER_DEGREE = 0.7 * 3840.0 / 0.7 * math.pi / 180.0  # 0.7 m from a display of 0.7 m and 3840 pixels: 67.02
COLOR_EXPONENT = 0.7  # q_c
COLOR_KNEE, ERROR_KNEE = 0.4, 0.95  # p_c and p_t: color differences up to 0.4 of the largest are errors up to 0.95
FEATURE_WIDTH = 0.082  # w, degrees
FEATURE_EXPONENT = 0.5  # q_f
# Sums of Gaussians a sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees, for contrast sensitivity: (a, b) of achromatic, red-green, blue-yellow.
ACHROMATIC, RED_GREEN = (1.0, 0.0047), (1.0, 0.0053)
BLUE_YELLOW = ((34.1, 0.04), (13.5, 0.025))
MAX_VARIANCE = 0.04  # the largest b
FILTER_BLOCK = 64  # rows or columns filtered at once
XYZ_OF_RGB = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
WHITE = XYZ_OF_RGB.sum(axis=1)
RELATIVE_OF_RGB = XYZ_OF_RGB / WHITE[:, None]  # X / X_n, Y / Y_n, Z / Z_n
OPPONENT_OF_RGB = np.array([[0.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]) @ RELATIVE_OF_RGB
CUBE_ROOT_LIMIT = (6.0 / 29.0) ** 3  # Below, CIELAB has a straight line in place of the cube root.
LINE_FACTOR, LINE_OFFSET = (29.0 / 6.0) ** 2 / 3.0, 4.0 / 29.0


@dataclass(frozen=True)
class FlipImage:
    """An image as FLIP compares it: Hunt-adjusted CIELAB colors (3, H, W) after the viewer's blur, and the magnitudes (H, W) of edges and
    points, all float32. Here channels come first: NumPy works on whole planes several times faster than on three values per pixel."""

    colors: np.ndarray
    edges: np.ndarray
    points: np.ndarray


def prepare_image(pixels: np.ndarray, pixels_per_degree: float = DEFAULT_PIXELS_PER_DEGREE, is_linear: bool = False) -> FlipImage:
    """Return what FLIP compares of an image, so that an image which is compared several times is filtered once.

    Args:
        pixels: (H, W, 3), clipped to 0..1: sRGB-encoded, or linear with sRGB primaries if `is_linear`.
        pixels_per_degree: pixels of the display within one degree of the viewer's visual field.

    Raises:
        ImageError: the image is not (H, W, 3), is empty, or contains values that are not finite.
        SettingsError: `pixels_per_degree` is not positive.
    """
    if pixels.ndim != 3 or pixels.shape[2] != 3 or not pixels.size:
        raise ImageError(f"An image to compare needs pixels with three channels, not an array of shape {pixels.shape}.")
    if not np.isfinite(pixels).all():
        raise ImageError("An image to compare has pixels that are not finite numbers; render it again.")
    if not pixels_per_degree > 0.0 or not math.isfinite(pixels_per_degree):
        raise SettingsError(f"The number of pixels per degree must be positive, not {pixels_per_degree:g}.")
    clipped = np.clip(np.asarray(pixels, np.float32), 0.0, 1.0)
    linear = clipped if is_linear else decode_signed_srgb(clipped).astype(np.float32)
    opponent = _opponent_colors(linear)
    edges, points = _detect_features(opponent[0], pixels_per_degree)
    return FlipImage(adjust_hunt(lab_colors(_blur(opponent, pixels_per_degree))), edges, points)


def compare(reference: FlipImage, image: FlipImage) -> np.ndarray:
    """Return the error (H, W) float32 perceived in each pixel of two prepared images of equal size: 0 where nothing differs, 1 at most."""
    difference = _hyab(reference.colors, image.colors) ** COLOR_EXPONENT
    knee = COLOR_KNEE * MAX_DIFFERENCE
    low = ERROR_KNEE / knee * difference
    high = ERROR_KNEE + (difference - knee) / (MAX_DIFFERENCE - knee) * (1.0 - ERROR_KNEE)
    color_error = np.where(difference < knee, low, high)
    feature_difference = np.maximum(np.abs(reference.edges - image.edges), np.abs(reference.points - image.points))
    feature_error = (feature_difference / math.sqrt(2.0)) ** FEATURE_EXPONENT
    return np.clip(color_error ** (1.0 - feature_error), 0.0, 1.0).astype(np.float32)


def filter_radius(pixels_per_degree: float) -> int:
    """Return the radius in pixels of the viewer's blur. Beyond the border of an image, its last pixels count as repeated."""
    return math.ceil(3.0 * math.sqrt(MAX_VARIANCE / (2.0 * math.pi**2)) * pixels_per_degree)


def _opponent_colors(linear: np.ndarray) -> np.ndarray:
    """Return the opponent colors (3, H, W) Y, X - Y and Y - Z of linear colors (H, W, 3).

    Their factors sum to 1, 0 and 0, so with green as the origin the chromatic parts of gray are exactly 0. Rounding would count, since the
    error grows with a small power of a difference.
    """
    red, green, blue = np.moveaxis(linear, 2, 0)
    opponent = np.tensordot(OPPONENT_OF_RGB[:, ::2].astype(np.float32), np.stack([red - green, blue - green]), 1)
    opponent[0] += green
    return opponent


def _blur(opponent: np.ndarray, pixels_per_degree: float) -> np.ndarray:
    """Return XYZ values (3, H, W) relative to the white, of `opponent` colors after the viewer's contrast sensitivity.

    Factors and offsets of the opponent colors do not change under filters with sum 1.
    """
    radius = filter_radius(pixels_per_degree)
    squares = (np.arange(-radius, radius + 1) / pixels_per_degree) ** 2
    luminance, red_green, blue_yellow = opponent
    y_blurred = _filter_separably(luminance, _gaussian(squares, ACHROMATIC[1]))
    x_blurred = y_blurred + _filter_separably(red_green, _gaussian(squares, RED_GREEN[1]))
    # A sum of two Gaussians is separable only term by term; each term keeps its part of the integral.
    heights = [amplitude * math.sqrt(math.pi / variance) for amplitude, variance in BLUE_YELLOW]
    curves = [np.exp(-(math.pi**2) * squares / variance) for _, variance in BLUE_YELLOW]
    sums = [height * curve.sum() ** 2 for height, curve in zip(heights, curves, strict=True)]
    terms = [part / sum(sums) * _filter_separably(blue_yellow, curve / curve.sum()) for part, curve in zip(sums, curves, strict=True)]
    z_blurred = y_blurred - terms[0] - terms[1]
    rgb = np.tensordot(RGB_OF_RELATIVE, np.stack([x_blurred, y_blurred, z_blurred]), 1)
    return np.tensordot(RELATIVE_OF_RGB.astype(np.float32), np.clip(rgb, 0.0, 1.0, out=rgb), 1)


def _gaussian(squares: np.ndarray, variance: float) -> np.ndarray:
    weights = np.exp(-(math.pi**2) * squares / variance)
    return weights / weights.sum()


def _filter_separably(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return `values` (H, W) filtered along x and along y. Borders are repeated."""
    return _filter(_filter(values, weights, axis=1), weights, axis=0)


def _filter(values: np.ndarray, weights: np.ndarray, axis: int) -> np.ndarray:
    """Return the correlation (H, W) float32 of `values` with an odd number of `weights` along an axis.

    Matrix products of blocks with a banded matrix take a third of the time of SciPy's filter, which is slow along columns.
    """
    radius, length = len(weights) // 2, values.shape[axis]
    width = FILTER_BLOCK + 2 * radius
    diagonals = np.zeros((FILTER_BLOCK, width + 1), np.float32)  # rows that are longer by one than those of the banded matrix
    diagonals[:, : len(weights)] = weights
    banded = diagonals.ravel()[: FILTER_BLOCK * width].reshape(FILTER_BLOCK, width)
    padded = np.pad(values, [(radius, radius) if index == axis else (0, 0) for index in (0, 1)], mode="edge")
    filtered = np.empty(values.shape, np.float32)
    for start in range(0, length, FILTER_BLOCK):
        stop = min(start + FILTER_BLOCK, length)
        block = banded[: stop - start, : stop - start + 2 * radius]
        if axis == 0:
            np.matmul(block, padded[start : stop + 2 * radius], out=filtered[start:stop])
        else:
            np.matmul(padded[:, start : stop + 2 * radius], block.T, out=filtered[:, start:stop])
    return filtered


def _detect_features(luminance: np.ndarray, pixels_per_degree: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the magnitudes (H, W) of edges and points in `luminance` (H, W): first and second derivatives of a Gaussian."""
    deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree
    radius = math.ceil(3.0 * deviation)
    x = np.arange(-radius, radius + 1, dtype=np.float64)
    gaussian = np.exp(-(x**2) / (2.0 * deviation**2))
    smooth = gaussian / gaussian.sum()
    smoothed, magnitudes = _filter(luminance, smooth, axis=1), []
    for derivative in (-x * gaussian, (x**2 / deviation**2 - 1.0) * gaussian):
        weights = _balance(derivative)
        along_x = _filter(_filter(luminance, weights, axis=1), smooth, axis=0)
        magnitudes.append(np.hypot(along_x, _filter(smoothed, weights, axis=0)))
    return magnitudes[0], magnitudes[1]


def _balance(weights: np.ndarray) -> np.ndarray:
    """Return `weights` (N,) scaled so that the negative ones sum to -1 and the positive ones to 1."""
    negative, positive = -weights[weights < 0.0].sum(), weights[weights > 0.0].sum()
    return np.where(weights < 0.0, weights / negative, weights / positive)


def lab_colors(relative: np.ndarray) -> np.ndarray:
    """Return CIELAB colors (3, ...) of XYZ values relative to the white."""
    x, y, z = np.where(relative > CUBE_ROOT_LIMIT, np.cbrt(relative), LINE_FACTOR * relative + LINE_OFFSET)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def adjust_hunt(lab: np.ndarray) -> np.ndarray:
    """Return CIELAB colors (3, ...) whose chroma grows with luminance (Hunt effect)."""
    return np.concatenate([lab[:1], 0.01 * lab[:1] * lab[1:]])


def _hyab(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the HyAB distances of CIELAB colors (3, ...), a metric for large differences."""
    difference = first - second
    return np.abs(difference[0]) + np.hypot(difference[1], difference[2])


RGB_OF_RELATIVE = (np.linalg.inv(XYZ_OF_RGB) * WHITE).astype(np.float32)
GREEN, BLUE = (adjust_hunt(lab_colors(XYZ_OF_RGB[:, channel] / WHITE)) for channel in (1, 2))
MAX_DIFFERENCE = float(_hyab(GREEN, BLUE)) ** COLOR_EXPONENT  # between the two most different colors of a display
