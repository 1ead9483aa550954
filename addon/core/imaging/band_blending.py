"""Multi-resolution spline: images are blended in frequency bands, wide bands over long distances and fine ones over short distances.

Burt and Adelson, "A Multiresolution Spline with Application to Image Mosaics" (1983), as in Textures Revisited, section 4.2, for images of
which only parts are known (normalized convolution).
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from .pyramids import expand_weighted, reduce_image, reduce_weighted


class Layer(NamedTuple):
    """An image (H, W, C) float32, where it is known (H, W) bool, and its fraction (H, W) float32 of the result, 0 where it is not known."""

    image: np.ndarray
    known: np.ndarray
    fraction: np.ndarray


def blend_bands(layers: Iterable[Layer], shape: tuple[int, int, int], levels: int) -> np.ndarray:
    """Return the blend (H, W, C) float32 of `layers` of this `shape` in `levels` bands; zero where no layer has a fraction.

    Layers are used one after the other, so that they may be computed as they are needed.
    """
    sizes = [shape[:2]]
    for _ in range(levels - 1):
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    sums = [np.zeros((*size, shape[2]), np.float32) for size in sizes]
    fractions = [np.zeros(size, np.float32) for size in sizes]
    for layer in layers:
        image, weights, fraction = layer.image, layer.known.astype(np.float32), layer.fraction
        for level in range(levels):
            band = image
            if level + 1 < levels:
                image, coarse_weights = reduce_weighted(image, weights)
                band = band - expand_weighted(image, (coarse_weights > 0.0).astype(np.float32), sizes[level])[0]
                band[weights == 0.0] = 0.0
                weights = coarse_weights
            sums[level] += fraction[..., None] * band
            fractions[level] += fraction
            if level + 1 < levels:
                fraction = reduce_image(fraction)
    result = _divide(sums[-1], fractions[-1])
    for level in reversed(range(levels - 1)):
        coarse = expand_weighted(result, (fractions[level + 1] > 0.0).astype(np.float32), sizes[level])[0]
        result = _divide(sums[level], fractions[level]) + np.where(fractions[level][..., None] > 0.0, coarse, 0.0)
    return result


def _divide(sums: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    return np.where(fractions[..., None] > 0.0, sums / np.where(fractions > 0.0, fractions, 1.0)[..., None], 0.0)
