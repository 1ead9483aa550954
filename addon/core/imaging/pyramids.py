"""Gaussian pyramids of images, after Burt and Adelson, "The Laplacian Pyramid as a Compact Image Code" (1983), with weights.

The kernel has five taps with a = 0.4, as in Textures Revisited, section 5.3. Any size works: sample (y, x) of a coarser level lies at
sample (2 y, 2 x) of the finer one, so a level has half the size, rounded up.
"""

import numpy as np
from scipy.ndimage import convolve1d

TAPS = np.array([0.05, 0.25, 0.4, 0.25, 0.05], np.float32)
MIN_WEIGHT = 1e-6  # sums of weights below this count as zero


def reduce_image(image: np.ndarray, wrap: tuple[bool, bool] = (False, False)) -> np.ndarray:
    """Return `image` (H, W, C) or (H, W) float32 at half the size, smoothed by the kernel before.

    wrap: whether opposite borders are neighbors, along rows and columns; otherwise the image is mirrored at its borders.
    """
    for axis in (0, 1):
        image = convolve1d(image, TAPS, axis=axis, mode="wrap" if wrap[axis] else "mirror")
        image = image[::2] if axis == 0 else image[:, ::2]
    return image


def reduce_weighted(image: np.ndarray, weights: np.ndarray, wrap: tuple[bool, bool] = (False, False)) -> tuple[np.ndarray, np.ndarray]:
    """Return `image` (H, W, C) and `weights` (H, W) >= 0 at half the size; samples count in proportion to their weights (normalized
    convolution). Samples that no weight reaches are zero."""
    sums = reduce_image(np.concatenate([image * weights[..., None], weights[..., None]], axis=2).astype(np.float32), wrap)
    weight = sums[..., -1]
    mean = np.where(weight[..., None] > MIN_WEIGHT, sums[..., :-1] / np.maximum(weight, MIN_WEIGHT)[..., None], 0.0)
    return mean, np.where(weight > MIN_WEIGHT, weight, 0.0)


def reduce_mask(mask: np.ndarray, wrap: tuple[bool, bool] = (False, False)) -> np.ndarray:
    """Return `mask` (H, W) bool at half the size: true where the kernel touches a true sample (section 5.4)."""
    return reduce_image(mask.astype(np.float32), wrap) > 0.0


def expand_weighted(image: np.ndarray, weights: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return `image` (H, W, C) at twice the size, rows and columns of `shape`, and the weights (H', W') of the result.

    Samples count in proportion to their `weights` (H, W) >= 0. Inverts the lattice of `reduce_image`: a result has this `shape` if that of
    `image` is half of it, rounded up. Samples that no weight reaches are zero.
    """
    sums = np.zeros((*shape, image.shape[2] + 1), np.float32)
    sums[::2, ::2] = np.concatenate([image * weights[..., None], weights[..., None]], axis=2)
    for axis in (0, 1):
        sums = convolve1d(sums, 2.0 * TAPS, axis=axis, mode="constant")
    weight = sums[..., -1]
    mean = np.where(weight[..., None] > MIN_WEIGHT, sums[..., :-1] / np.maximum(weight, MIN_WEIGHT)[..., None], 0.0)
    return mean, np.where(weight > MIN_WEIGHT, weight, 0.0)
