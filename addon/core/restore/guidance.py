"""What a copy in a hole should look like: the color of the smooth fill there, and the contrast that texture has next to the hole.

A copy costs the more, the more it differs. The smooth fill itself is one of the candidates: where texture is faint, or nothing fits, it
remains.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter

from ..imaging.diffusion import diffuse
from .levels import Level, Page

COLOR_SIGMA = 2.5  # pixels
DETAIL_SIGMA = 4.0  # pixels; smaller details are contrast
CONTRAST_SIGMA = 5.0  # pixels
EXPLAINED = 5  # pixels from a curve to edges that it continues, which are not texture
VARIATION_SIGMA = 12.0  # pixels
LACK = 3.0  # cost of a pixel without texture, relative to the contrast next to the hole
NOISE = 0.02  # contrast below which texture does not count
MIN_VARIATION = 0.02  # Of colors.
HINGE = 2.0  # deviations of the colors around that a copy may differ
CONTRAST_WEIGHT = 1.5
CONTRAST_TOLERANCE = 0.4  # natural logarithm
MAX_DIFFERENCE = 6.0
WEIGHT = 0.2  # Of a pixel with a difference of 1, relative to the deviation of the texture.


@dataclass(frozen=True)
class Guide:
    """The appearance of the pixels of a level, and what is wanted in its holes.

    Attributes:
        features: (H * W, C + 1) float32, color and logarithm of contrast.
        scale: (H * W,) float32, the inverse of how much colors vary around.
        lack: (H * W,) float32, in smooth fills, the cost of the contrast that they lack.
        fills: (P,) int, per page the offset from its pixels to those of its smooth fill, 0 where it has none.
    """

    features: np.ndarray
    scale: np.ndarray
    lack: np.ndarray
    fills: np.ndarray

    def costs(self, pixels: np.ndarray, sources: np.ndarray, deviation: float) -> np.ndarray:
        """Return the costs (P,) of copies of `sources` (P,) at `pixels` (P,). deviation: of the texture."""
        differences = np.abs(self.features[pixels] - self.features[sources])
        color = np.sqrt(np.square(differences[:, :-1]).sum(axis=1)) * self.scale[pixels]
        excess = np.maximum(color - HINGE, 0.0) + CONTRAST_WEIGHT * np.maximum(differences[:, -1] - CONTRAST_TOLERANCE, 0.0)
        return deviation * WEIGHT * np.minimum(excess, MAX_DIFFERENCE) + self.lack[sources]


def build_guide(level: Level, pages: list[Page], curves: list[np.ndarray]) -> Guide:
    """Describe the pixels of `level`, whose first pages are those of holes, each with its curves (H, W) bool, followed by as many with their
    smooth fills."""
    count = len(curves)
    features = np.zeros((level.hole.size, level.texture.shape[1] + 1), np.float32)
    scale = np.zeros(level.hole.size, np.float32)
    fills, lack = np.zeros(len(pages), np.int64), np.zeros(level.hole.size, np.float32)
    for index, page in enumerate(pages):
        pixels = level.pixels(index)
        known = page.known & ~page.hole
        color, contrast = _describe(page.texture, known)
        if index < count:
            fill = pages[index + count].texture
            fills[index] = (level.tops[index + count] - level.tops[index]) * level.shape[1]
            squares = _blur(color**2, known, VARIATION_SIGMA) - _blur(color, known, VARIATION_SIGMA) ** 2
            variation = np.sqrt(np.maximum(squares, 0.0).sum(axis=2, keepdims=True))
            scale[pixels] = 1.0 / (diffuse(variation, page.hole, None, page.wrap).ravel() + MIN_VARIATION)
            near_curve = binary_dilation(curves[index] & ~page.hole, iterations=EXPLAINED)
            wanted = diffuse(contrast, page.hole | near_curve, curves[index] & page.hole, page.wrap)
            contrast = np.where(page.hole[..., None], wanted, contrast)
            color = np.where(page.hole[..., None], _blur(fill, np.ones_like(known), COLOR_SIGMA), color)
            features[pixels + fills[index]] = np.concatenate([color, contrast], axis=2).reshape(len(pixels), -1)
            lack[pixels + fills[index]] = LACK * (np.exp(contrast.ravel()) - NOISE)
        elif index < 2 * count:
            continue
        features[pixels] = np.concatenate([color, contrast], axis=2).reshape(len(pixels), -1)
    return Guide(features, scale, lack, fills)


def _describe(texture: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the color (H, W, C) and the logarithm of the contrast (H, W, 1) around each pixel, of the known pixels."""
    residual = np.square(texture - _blur(texture, known, DETAIL_SIGMA)).sum(axis=2, keepdims=True)
    contrast = np.log(np.sqrt(np.maximum(_blur(residual, known, CONTRAST_SIGMA), 0.0)) + NOISE)
    return _blur(texture, known, COLOR_SIGMA), contrast.astype(np.float32)


def _blur(values: np.ndarray, known: np.ndarray, sigma: float) -> np.ndarray:
    """Return the Gaussian mean (H, W, C) of the known pixels."""
    weights = np.maximum(gaussian_filter(known.astype(np.float32), sigma, mode="constant"), 1e-6)[..., None]
    return gaussian_filter(values * known[..., None], (sigma, sigma, 0.0), mode="constant") / weights
