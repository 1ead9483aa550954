"""How much of the error of a coefficient a viewer sees: after minification, and through the eye's contrast sensitivity.

An error in a block of a texture is seen through the filter of mipmaps, as wide as the part of it that a pixel covers, and through the
filters of FLIP for luminance, red-green and blue-yellow, about those of Y, Cr and Cb. Each cosine is weighted by the fraction of its energy
that remains. The color of a block says by how much its appearance changes with Y, Cb and Cr.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....imaging.colors import decode_signed_srgb
from ....imaging.flip import (
    ACHROMATIC,
    BLUE_YELLOW,
    COLOR_EXPONENT,
    COLOR_KNEE,
    ERROR_KNEE,
    FEATURE_EXPONENT,
    FEATURE_WIDTH,
    MAX_DIFFERENCE,
    RED_GREEN,
    RELATIVE_OF_RGB,
    adjust_hunt,
    lab_colors,
)
from .dct_blocks import BLOCK, COEFFICIENTS, RGB_OF_YCC, ZIGZAG
from .tile_coding import Scan

FREQUENCIES = 256  # of spectra
SHADING = 0.75  # mean fraction of a color that light leaves
MIN_CONTRAST = 1e-4  # of linear luminance
CONTRAST_STEP = 16.0  # of Y for second derivatives
COLOR_STEP = 4.0  # of Y, Cb and Cr for derivatives
POINT_INTEGRAL = 2.0 * math.exp(-0.5) / math.sqrt(2.0 * math.pi)  # of the positive part of (x^2 - 1) times the normal distribution
FEATURE_FACTOR = 1.0  # of the root mean square of feature differences
MAX_FEATURE_ERROR = 0.9
DATA_LUMINANCE = 0.3 / 255.0  # linear, per value of textures of data
DATA_SCALE = 40.0 / 255.0  # lightness per value of textures of data, such as normals
ERROR_FACTOR = ERROR_KNEE / (COLOR_KNEE * MAX_DIFFERENCE)  # FLIP of a difference of color to the power of COLOR_EXPONENT


def filter_energies(footprints: np.ndarray, pixels_per_degree: float) -> np.ndarray:
    """Return the fraction (3, L, 64) of the energy of each cosine of Y, Cb and Cr, in zigzag order, that is seen at `footprints` (L,), in
    texels per pixel."""
    heights = [amplitude * math.pi / variance for amplitude, variance in BLUE_YELLOW]
    blue_yellow = sum(height * variance for height, (_, variance) in zip(heights, BLUE_YELLOW, strict=True)) / sum(heights)
    energies = np.empty((3, len(footprints), COEFFICIENTS))
    for component, variance in enumerate((ACHROMATIC[1], blue_yellow, RED_GREEN[1])):
        deviation = math.sqrt(0.5 * variance) / math.pi * pixels_per_degree
        for index, footprint in enumerate(footprints):
            line = _line_energies(footprint, deviation, 0)
            energies[component, index] = np.outer(line, line).ravel()[ZIGZAG]
    return energies


def feature_energies(footprints: np.ndarray, pixels_per_degree: float) -> np.ndarray:
    """Return how strongly FLIP's detectors of edges and points respond, squared, to a cosine of unit energy: (L, 64), in zigzag order."""
    energies = np.empty((len(footprints), COEFFICIENTS))
    deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree
    for index, footprint in enumerate(footprints):
        smooth, edges, points = (_line_energies(footprint, deviation, order) for order in range(3))
        # The detectors are scaled so that their positive parts sum to 1.
        edges = edges * 2.0 * math.pi * deviation**2
        points = points * (deviation**2 / POINT_INTEGRAL) ** 2
        energies[index] = np.maximum(*(np.outer(line, smooth) + np.outer(smooth, line) for line in (edges, points))).ravel()[ZIGZAG]
    return energies


def _line_energies(footprint: float, deviation: float, order: int) -> np.ndarray:
    """Return the energy (8,) that is left of each cosine of 8 texels after mipmaps and a Gaussian of `deviation` pixels, or its derivative
    of this `order`.

    Mipmaps are means over as many texels as a pixel covers, interpolated. Frequencies that they leave beyond those of pixels appear as
    lower ones, which the eye sees better.
    """
    frequencies = (np.arange(FREQUENCIES) + 0.5) / FREQUENCIES - 0.5  # cycles per texel
    centers = np.arange(BLOCK) + 0.5
    cosines = np.cos(np.pi / BLOCK * np.outer(np.arange(BLOCK), centers)) * math.sqrt(2.0 / BLOCK)
    cosines[0] /= math.sqrt(2.0)
    spectra = np.abs(cosines @ np.exp(-2j * np.pi * np.outer(centers, frequencies))) ** 2
    if footprint > 1.0:
        means = np.sin(np.pi * frequencies * footprint) / (footprint * np.sin(np.pi * frequencies))
        aliases = frequencies * footprint - np.rint(frequencies * footprint)
        filters = (means * np.sinc(aliases) ** 2) ** 2
    else:
        aliases = frequencies * footprint
        filters = np.sinc(frequencies) ** 4
    angular = 2.0 * np.pi * aliases
    filters = filters * (angular**order * np.exp(-0.5 * (angular * deviation) ** 2)) ** 2
    return (spectra * filters).mean(axis=1)


def color_sensitivities(means: np.ndarray) -> np.ndarray:
    """Return the squared change of appearance (N, 3), in units of FLIP's color space, per value of Y, Cb and Cr around colors `means`
    (N, 3), YCbCr with Y of -128 to 127."""

    colors = means + [128.0, 0.0, 0.0]
    squares = np.empty((len(means), 3))
    for component in range(3):
        step = np.zeros(3)
        step[component] = COLOR_STEP
        difference = _appearance((colors + step) @ RGB_OF_YCC.T) - _appearance((colors - step) @ RGB_OF_YCC.T)
        difference /= 2.0 * COLOR_STEP
        squares[:, component] = (np.abs(difference[:, 0]) + np.hypot(difference[:, 1], difference[:, 2])) ** 2
    return squares


def _appearance(encoded: np.ndarray) -> np.ndarray:
    """Return FLIP's colors (N, 3) of values (N, 3) of 0 to 255, in the light of a surface."""
    relative = SHADING * decode_signed_srgb(np.clip(encoded / 255.0, 0.0, 1.0)) @ RELATIVE_OF_RGB.T
    return adjust_hunt(lab_colors(relative))


def data_sensitivities() -> np.ndarray:
    """Return what `color_sensitivities` returns for textures of data: (3,), the same for an error of each of R, G and B."""
    return (RGB_OF_YCC**2).sum(axis=0) * DATA_SCALE**2


def luminance_sensitivities(means: np.ndarray) -> np.ndarray:
    """Return the squared change of linear luminance (N,) per value of Y around colors `means` (N, 3), as for `color_sensitivities`."""
    encoded = np.clip((means[:, 0, None] + [128.0 - COLOR_STEP, 128.0 + COLOR_STEP]) / 255.0, 0.0, 1.0)
    low, high = decode_signed_srgb(encoded).T
    return (SHADING * (high - low) / (2.0 * COLOR_STEP)) ** 2


def contrast_sensitivities(means: np.ndarray) -> np.ndarray:
    """Return the change of appearance (N, 3) around colors `means` (N, 3) where light is averaged, per variance of Y, Cb and Cr.

    The mean of linear values is brighter than that of encoded ones. Of Cb blue counts, of Cr red.
    """
    encoded = np.clip((means + [128.0, 0.0, 0.0]) @ RGB_OF_YCC.T, 0.0, 255.0)
    steps = np.array([-1.0, 0.0, 1.0]) * CONTRAST_STEP
    channels = np.stack([(means[:, 0] + 128.0).clip(0.0, 255.0), encoded[:, 2], encoded[:, 0]], axis=1)
    low, center, high = np.moveaxis(decode_signed_srgb(np.clip((channels[..., None] + steps) / 255.0, 0.0, 1.0)), -1, 0)
    shifts = (high - 2.0 * center + low) / CONTRAST_STEP / np.maximum(high - low, MIN_CONTRAST)
    gray, blue, red = np.ones(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    changes = np.empty((len(means), 3))
    for component, (direction, amplitude) in enumerate(((gray, 1.0), (blue, RGB_OF_YCC[2, 1] ** 2), (red, RGB_OF_YCC[0, 2] ** 2))):
        difference = _appearance(encoded + COLOR_STEP * direction) - _appearance(encoded - COLOR_STEP * direction)
        size = (np.abs(difference[:, 0]) + np.hypot(difference[:, 1], difference[:, 2])) / (2.0 * COLOR_STEP)
        changes[:, component] = size * shifts[:, component] * amplitude
    return changes


@dataclass(frozen=True, eq=False)
class BlockWeights:
    """What an error of tiles of N x B blocks means, float32, per component.

    colors: (N, B, 64), of squared errors of coefficients for the color that is seen. features: (N, B, 64), of those of Y for edges and
    points. contrasts: (N, B, 64), of the squares of coefficients that are not seen themselves, for brightness. means: (N, B), of squared
    errors of DC coefficients that are alike everywhere.
    """

    colors: list[np.ndarray]
    features: np.ndarray
    contrasts: list[np.ndarray]
    means: list[np.ndarray]


@dataclass(frozen=True, eq=False)
class BlockErrors:
    """What a viewer sees of tiles: (M, N, B) float32 without any scan, all gray, and by how much each of K scans lowers it, (M, K, N, B)
    float32, after those before it of its band: squared differences of color, squared differences of features, and for each component the
    difference of color by lost contrasts. They add up, in whatever order bands come."""

    totals: np.ndarray
    gains: np.ndarray


def predict_flip(totals: np.ndarray) -> np.ndarray:
    """Return the FLIP error of pixels with errors `totals` (M, N, B), see `BlockErrors`."""
    colors, features = totals[:2]
    squares = np.maximum(colors, 0.0) + (totals[2:] ** 2).sum(axis=0)
    color_error = np.minimum(ERROR_FACTOR * squares ** (0.5 * COLOR_EXPONENT), 1.0)
    difference = FEATURE_FACTOR * np.sqrt(np.maximum(features, 0.0)) / math.sqrt(2.0)
    return color_error ** (1.0 - np.minimum(difference**FEATURE_EXPONENT, MAX_FEATURE_ERROR))


def measure_errors(
    coefficients: np.ndarray, quantized: np.ndarray, steps: np.ndarray, scans: Sequence[Scan], weights: BlockWeights
) -> BlockErrors:
    """Return the errors of tiles.

    Args:
        coefficients, quantized: (C, N, B, 64). steps: (C, N, 64).
    """
    shape = coefficients.shape[1:3]
    kinds = 2 + len(coefficients)
    totals = np.zeros((kinds, *shape), np.float32)
    gains = np.zeros((kinds, len(scans), *shape), np.float32)

    def weigh(known: np.ndarray | float, component: int, columns: slice) -> np.ndarray:
        values = coefficients[component, :, :, columns]
        squares = (values - known) ** 2
        found = np.zeros((kinds, *shape), np.float32)
        found[0] = np.einsum("nbk,nbk->nb", squares, weights.colors[component][..., columns])
        if component == 0:
            found[1] = np.einsum("nbk,nbk->nb", squares, weights.features[..., columns])
        found[2 + component] = np.einsum("nbk,nbk->nb", values**2 - known**2, weights.contrasts[component][..., columns])
        return found / COEFFICIENTS

    band, left = None, totals
    for index, scan in enumerate(scans):
        components = range(len(coefficients)) if scan.component is None else (scan.component,)
        columns = slice(scan.first, scan.last + 1)
        if band != (scan.component, scan.first):
            band = scan.component, scan.first
            left = sum(weigh(0.0, component, columns) for component in components)
            if scan.component is None:  # gray instead of colors, not an error that differs from block to block
                left[0] = sum(coefficients[component, :, :, 0] ** 2 * weights.means[component] for component in components) / COEFFICIENTS
            totals += left
        remaining = np.zeros_like(left)
        for component in components:
            values = quantized[component, :, :, columns]
            known = np.sign(values) * ((np.abs(values) >> scan.shift) << scan.shift)
            remaining += weigh(known * steps[component, :, None, columns].astype(np.float32), component, columns)
        gains[:, index] = left - remaining
        left = remaining
    return BlockErrors(totals, gains)
