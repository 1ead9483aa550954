"""How much of the error of a coefficient a viewer sees: after the texture is minified, and through the eye's contrast sensitivity.

An error in a block of a texture is seen through the filter of mipmaps, as wide as what a pixel covers of the texture, and through the filters
of FLIP for luminance, red-green and blue-yellow, which are about those of Y, Cr and Cb. What is left of the energy of each cosine is its
weight. The color of a block says by how much its appearance changes with Y, Cb and Cr.
"""

import math
from collections.abc import Sequence

import numpy as np

from ....imaging.colors import decode_signed_srgb
from ....imaging.flip import (
    ACHROMATIC,
    BLUE_YELLOW,
    COLOR_EXPONENT,
    COLOR_KNEE,
    ERROR_KNEE,
    MAX_DIFFERENCE,
    RED_GREEN,
    RELATIVE_OF_RGB,
    adjust_hunt,
    lab_colors,
)
from .dct_blocks import BLOCK, COEFFICIENTS, RGB_OF_YCC, ZIGZAG
from .tile_coding import Scan

FILTER_VARIANCE = 1.0 / 12.0 + 1.0 / 6.0  # of the box of a mipmap and of bilinear interpolation, relative to squared footprints
PIXEL_WIDTH = 3  # deviations of filters
SHADING = 0.75  # mean fraction of a color that light leaves
COLOR_STEP = 4.0  # of Y, Cb and Cr for derivatives
DATA_SCALE = 40.0 / 255.0  # lightness per value of textures of data, such as normals
ERROR_FACTOR = ERROR_KNEE / (COLOR_KNEE * MAX_DIFFERENCE)  # FLIP of a difference of color to the power of COLOR_EXPONENT


def filter_energies(footprints: np.ndarray, pixels_per_degree: float) -> np.ndarray:
    """Return the fraction (3, L, 64) of the energy of each cosine of Y, Cb and Cr, in zigzag order, that is seen at `footprints` (L,), in
    texels per pixel."""
    blue_yellow = sum(amplitude * math.pi / variance * variance for amplitude, variance in BLUE_YELLOW)
    blue_yellow /= sum(amplitude * math.pi / variance for amplitude, variance in BLUE_YELLOW)
    energies = np.empty((3, len(footprints), COEFFICIENTS))
    for component, variance in enumerate((ACHROMATIC[1], blue_yellow, RED_GREEN[1])):
        eye = variance / (2.0 * math.pi**2) * pixels_per_degree**2  # pixels squared
        for index, footprint in enumerate(footprints):
            total = eye * footprint**2 + FILTER_VARIANCE * max(footprint, 1.0) ** 2
            line = _cosine_energies(math.sqrt(total))
            energies[component, index] = np.outer(line, line).ravel()[ZIGZAG]
    return energies


def _cosine_energies(deviation: float) -> np.ndarray:
    """Return the energy (8,) that a Gaussian of `deviation` texels leaves of each cosine of 8 texels."""
    radius = math.ceil(PIXEL_WIDTH * deviation)
    gaussian = np.exp(-0.5 * (np.arange(-radius, radius + 1) / deviation) ** 2)
    gaussian /= gaussian.sum()
    places = np.arange(BLOCK) + 0.5
    cosines = np.cos(np.pi / BLOCK * np.outer(np.arange(BLOCK), places)) * math.sqrt(2.0 / BLOCK)
    cosines[0] /= math.sqrt(2.0)
    return np.array([(np.convolve(cosine, gaussian) ** 2).sum() for cosine in cosines])


def color_sensitivities(means: np.ndarray) -> np.ndarray:
    """Return the squared change of appearance (N, 3), in units of FLIP's color space, per value of Y, Cb and Cr around colors `means`
    (N, 3), YCbCr with Y of -128 to 127."""

    def appearance(colors: np.ndarray) -> np.ndarray:
        encoded = np.clip((colors + [128.0, 0.0, 0.0]) @ RGB_OF_YCC.T / 255.0, 0.0, 1.0)
        relative = SHADING * decode_signed_srgb(encoded) @ RELATIVE_OF_RGB.T
        return adjust_hunt(lab_colors(relative))

    squares = np.empty((len(means), 3))
    for component in range(3):
        step = np.zeros(3)
        step[component] = COLOR_STEP
        difference = (appearance(means + step) - appearance(means - step)) / (2.0 * COLOR_STEP)
        squares[:, component] = (np.abs(difference[:, 0]) + np.hypot(difference[:, 1], difference[:, 2])) ** 2
    return squares


def data_sensitivities() -> np.ndarray:
    """Return what `color_sensitivities` returns for textures of data: (3,), the same for an error of each of R, G and B."""
    return (RGB_OF_YCC**2).sum(axis=0) * DATA_SCALE**2


def predict_flip(squared_differences: np.ndarray) -> np.ndarray:
    """Return the FLIP error of pixels whose color differs by the root of the mean `squared_differences`."""
    return ERROR_FACTOR * np.maximum(squared_differences, 0.0) ** (0.5 * COLOR_EXPONENT)


def measure_gains(
    coefficients: np.ndarray, quantized: np.ndarray, steps: np.ndarray, scans: Sequence[Scan], weights: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the squared differences (N, B) that a viewer sees of tiles without any scan, all gray, and by how much each of K `scans` lowers
    them (K, N, B), float32, after those before it of its band. Gains add up, in whatever order bands come.

    Args:
        coefficients, quantized: (C, N, B, 64). steps: (C, 64). weights: per component (N, B, 64).
    """
    before = np.zeros(coefficients.shape[1:3], np.float32)
    gains = np.zeros((len(scans), *before.shape), np.float32)
    band, left = None, before
    for index, scan in enumerate(scans):
        components = range(len(coefficients)) if scan.component is None else (scan.component,)
        if band != (scan.component, scan.first):
            band = scan.component, scan.first
            left = np.zeros_like(before)
            for component in components:
                left += _weigh(coefficients[component, :, :, scan.first : scan.last + 1], weights[component], scan)
            before += left
        remaining = np.zeros_like(before)
        for component in components:
            columns = slice(scan.first, scan.last + 1)
            values = quantized[component, :, :, columns]
            if scan.component is None:
                known = (values >> scan.shift) << scan.shift
            else:
                known = np.sign(values) * ((np.abs(values) >> scan.shift) << scan.shift)
            errors = coefficients[component, :, :, columns] - known * steps[component, columns].astype(np.float32)
            remaining += _weigh(errors, weights[component], scan)
        gains[index] = left - remaining
        left = remaining
    return before, gains


def _weigh(errors: np.ndarray, weights: np.ndarray, scan: Scan) -> np.ndarray:
    return np.einsum("nbk,nbk,nbk->nb", errors, errors, weights[..., scan.first : scan.last + 1]) / COEFFICIENTS
