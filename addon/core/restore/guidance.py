"""What a copy in a hole should look like: the color of the fills there, and the contrast that texture has next to the hole.

A copy costs the more, the more it differs. The fills are candidates as well, a smooth one and one by patches: where texture is faint, where
the surroundings are objects rather than texture, or where nothing fits, they remain.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt, gaussian_filter

from ..imaging.diffusion import diffuse
from .levels import RADIUS, Level, Page

COLOR_SIGMA = 2.5  # pixels
DETAIL_SIGMA = 4.0  # pixels; smaller details are contrast
CONTRAST_SIGMA = 5.0  # pixels
VARIATION_SIGMA = 12.0  # pixels
WIDE_CONTRAST_SIGMA, WIDE_SIGMA = 12.0, 36.0  # pixels; a wide view, in which bricks and leaves are texture as well
SHALLOW = 4 * RADIUS + 2  # pixels to the middle of a hole, twice the side of a patch
CURVE_REACH = 5  # pixels from a curve to edges that it continues, which are not texture
NOISE = 0.02  # contrast below which texture does not count
COLOR_WEIGHT = 0.2  # per deviation beyond the tolerance
MIN_DEVIATION = 0.02  # added to the deviation of colors around a pixel
COLOR_TOLERANCE = 2.0  # deviations
CONTRAST_WEIGHT = 0.1
CONTRAST_TOLERANCE = 0.4  # natural logarithm
MAX_COST = 1.2
LACK_WEIGHT = 2.5  # Of contrast that a fill lacks, where texture is even.
MAX_SPREAD = 0.25  # deviation of the logarithm of the contrast, beyond which it belongs to objects
MAX_WIDE_SPREAD = 0.125  # the same in the wide view, below which all around a hole is texture


class Look(NamedTuple):
    """The appearance of the pixels of a page.

    Attributes:
        color: (H, W, C) float32.
        contrast: (H, W, 1) float32, natural logarithms; in a hole those that its surroundings suggest.
        scale: (H, W, 1) float32, the inverse of the deviation of colors around.
        evenness: (H, W, 1) float32, 1 where contrast is even, as in texture, and near 0 between objects.
    """

    color: np.ndarray
    contrast: np.ndarray
    scale: np.ndarray
    evenness: np.ndarray


@dataclass(frozen=True)
class Guide:
    """What copies cost, for the pixels of a level.

    Attributes:
        colors: (H * W, C) float32.
        contrasts: (H * W,) float32, natural logarithms.
        scales: (H * W,) float32, the inverse of the deviation of the colors around.
        lacks: (H * W,) float32, the costs of the contrast that fills lack, relative to the deviation of the texture.
        fills: For each page with a hole the offsets from its pixels to those of its fills; that by patches is the last one.
        are_shallow: For each page with a hole, whether its fill by patches is taken as it is, since what surrounds a shallow hole tells
            more about it than any other part of the image.
    """

    colors: np.ndarray
    contrasts: np.ndarray
    scales: np.ndarray
    lacks: np.ndarray
    fills: list[list[int]]
    are_shallow: list[bool]

    def costs(self, pixels: np.ndarray, sources: np.ndarray, deviation: float) -> np.ndarray:
        """Return the costs (P,) of copies of `sources` (P,) at `pixels` (P,). deviation: of the texture."""
        colors = np.linalg.norm(self.colors[pixels] - self.colors[sources], axis=1) * self.scales[pixels]
        contrasts = np.abs(self.contrasts[pixels] - self.contrasts[sources])
        excess = COLOR_WEIGHT * np.maximum(colors - COLOR_TOLERANCE, 0.0) + CONTRAST_WEIGHT * np.maximum(
            contrasts - CONTRAST_TOLERANCE, 0.0
        )
        return deviation * np.minimum(excess, MAX_COST) + self.lacks[sources]


def describe_page(page: Page, curves: np.ndarray) -> Look:
    """Describe the pixels of a page with a hole, except for the colors in it. curves: (H, W) bool, edges that continue in the hole."""
    known = page.known & ~page.hole
    color, contrast = _describe(page.texture, known)
    deviations = np.concatenate([_deviation(color, known), _deviation(contrast, known)], axis=2)
    deviation, spread = np.split(diffuse(deviations, page.hole, None, page.wrap), 2, axis=2)
    near_curve = binary_dilation(curves & ~page.hole, iterations=CURVE_REACH)
    expected = diffuse(contrast, page.hole | near_curve, curves & page.hole, page.wrap)
    contrast = np.where(page.hole[..., None], expected, contrast)
    wide_spread = _deviation(_measure_contrast(page.texture, known, WIDE_CONTRAST_SIGMA), known, WIDE_SIGMA)[page.hole].mean()
    is_texture = wide_spread < MAX_WIDE_SPREAD and expected[page.hole].mean() > np.log(2.0 * NOISE)
    evenness = np.ones_like(spread) if is_texture else np.exp(-np.square(spread / MAX_SPREAD))
    return Look(color, contrast, 1.0 / (deviation + MIN_DEVIATION), evenness)


def build_guide(level: Level, pages: list[Page], looks: list[Look], fills: list[list[int]]) -> Guide:
    """Return the guide of `level`, built from `pages`. The first ones have holes, of which `looks` are; fills: for each the numbers of the
    pages with its fills."""
    size, fill_numbers = level.hole.size, {number for numbers in fills for number in numbers}
    colors, contrasts = np.zeros((size, level.texture.shape[1]), np.float32), np.zeros(size, np.float32)
    scales, lacks = np.zeros(size, np.float32), np.zeros(size, np.float32)
    offsets = [[int(level.tops[number] - level.tops[index]) * level.shape[1] for number in numbers] for index, numbers in enumerate(fills)]
    for index, page in enumerate(pages):
        if index in fill_numbers:
            continue
        pixels = level.pixels(index)
        if index >= len(looks):
            color, contrast = _describe(page.texture, page.known)
        else:
            color, contrast, scale, evenness = looks[index]
            scales[pixels] = scale.ravel()
            filled = [_describe(pages[number].texture, page.hole) for number in fills[index]]
            color = np.where(page.hole[..., None], np.mean([each[0] for each in filled], axis=0), color)
            for offset, (fill_color, fill_contrast) in zip(offsets[index], filled, strict=True):
                colors[pixels + offset], contrasts[pixels + offset] = _flatten(fill_color), contrast.ravel()
                lack = LACK_WEIGHT * evenness * np.maximum(np.exp(contrast) - np.exp(fill_contrast), 0.0)
                lacks[pixels + offset] = lack.ravel()
        colors[pixels], contrasts[pixels] = _flatten(color), contrast.ravel()
    are_shallow = [
        len(numbers) > 1 and bool(distance_transform_edt(page.hole).max() <= SHALLOW) for page, numbers in zip(pages, fills, strict=False)
    ]
    return Guide(colors, contrasts, scales, lacks, offsets, are_shallow)


def _describe(texture: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the color (H, W, C) and the logarithm of the contrast (H, W, 1) around each pixel, of the known pixels."""
    return _blur(texture, known, COLOR_SIGMA), _measure_contrast(texture, known, CONTRAST_SIGMA)


def _measure_contrast(texture: np.ndarray, known: np.ndarray, sigma: float) -> np.ndarray:
    """Return the logarithm of the contrast (H, W, 1) around each pixel, of the known pixels."""
    residual = np.square(texture - _blur(texture, known, DETAIL_SIGMA)).sum(axis=2, keepdims=True)
    return np.log(np.sqrt(np.maximum(_blur(residual, known, sigma), 0.0)) + NOISE).astype(np.float32)


def _deviation(values: np.ndarray, known: np.ndarray, sigma: float = VARIATION_SIGMA) -> np.ndarray:
    """Return the standard deviation (H, W, 1) of the known ones of `values` (H, W, C) around each pixel, of all channels together."""
    variance = _blur(values**2, known, sigma) - _blur(values, known, sigma) ** 2
    return np.sqrt(np.maximum(variance, 0.0).sum(axis=2, keepdims=True))


def _blur(values: np.ndarray, known: np.ndarray, sigma: float) -> np.ndarray:
    """Return the Gaussian mean (H, W, C) of the known pixels."""
    weights = np.maximum(gaussian_filter(known.astype(np.float32), sigma, mode="constant"), 1e-6)[..., None]
    return gaussian_filter(values * known[..., None], (sigma, sigma, 0.0), mode="constant") / weights


def _flatten(values: np.ndarray) -> np.ndarray:
    return values.reshape(-1, values.shape[2])
