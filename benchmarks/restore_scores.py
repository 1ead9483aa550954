"""Measures of restored images: patch distributions, seams, and low frequencies.

Images are (H, W, C) float sRGB values in 0..1, masks (H, W) bool. Every measure has the same random choices for all methods.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, maximum_filter

from farfield.addon.core.imaging.edges import find_edges
from farfield.addon.core.imaging.metrics import psnr
from lib.flip_metric import flip_maps

PATCH_SIZE = 7
PROJECTIONS = 128
MAX_PATCHES = 20_000
LOW_BAND_SIGMA = 10.0  # pixels
NEARBY = 24  # pixels from the hole
EDGE_SCALES = (1.0, 2.5)  # pixels
EDGE_LIMITS = (0.015, 0.04)  # weak and strong gradients per pixel
MAX_EDGE_DISTANCE = 20.0  # pixels
FALSE_EDGE = 3.0  # times the gradient across the boundary of the hole
MIN_FALSE_EDGE = 0.08
MAX_FALSE_FRACTION = 0.05  # Of the boundary.


def patch_distances(image: np.ndarray, truth: np.ndarray, mask: np.ndarray, seed: int) -> tuple[float, float]:
    """Return the sliced Wasserstein distances between patches centered in the hole and as many patches that lie completely in the rest, and
    between the former and those of the truth.

    The distance is the mean over random unit vectors of the first Wasserstein distance of the projected patches, in units of the image.
    """
    random = np.random.default_rng(seed)
    radius = PATCH_SIZE // 2
    inner = (slice(radius, -radius), slice(radius, -radius))
    windows = np.lib.stride_tricks.sliding_window_view(mask, (PATCH_SIZE, PATCH_SIZE))
    filled, rest = np.flatnonzero(mask[inner]), np.flatnonzero(~windows.any(axis=(2, 3)))
    count = min(len(filled), len(rest), MAX_PATCHES)
    filled, rest = (random.permutation(indices)[:count] for indices in (filled, rest))
    vectors = random.standard_normal((PATCH_SIZE * PATCH_SIZE * image.shape[2], PROJECTIONS)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=0)
    first, second, true = (
        np.sort(_patches(pixels, indices) @ vectors, axis=0) for pixels, indices in ((image, filled), (image, rest), (truth, filled))
    )
    return float(np.abs(first - second).mean()), float(np.abs(first - true).mean())


def _patches(image: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Return the patches (N, PATCH_SIZE^2 * C) float32 at flat `indices` of all patch positions."""
    windows = np.lib.stride_tricks.sliding_window_view(image.astype(np.float32), (PATCH_SIZE, PATCH_SIZE), axis=(0, 1))
    rows, columns = np.unravel_index(indices, windows.shape[:2])
    return windows[rows, columns].reshape(len(indices), -1)


def boundary_energy(image: np.ndarray, mask: np.ndarray, reference: np.ndarray | None = None) -> float:
    """Return the mean squared difference across the boundary of the hole, relative to that of neighbors outside the hole: 1 without a seam.

    Horizontal and vertical pairs count outside as often as they occur on the boundary, so that the direction of a texture does not matter.
    `reference` (H, W) bool restricts the neighbors outside.
    """
    outside = ~mask if reference is None else reference & ~mask
    boundary_sum, expected_sum = 0.0, 0.0
    for axis in (0, 1):
        squares = (np.diff(image.astype(np.float64), axis=axis) ** 2).sum(axis=2)
        first, second = (np.delete(mask, end, axis=axis) for end in (-1, 0))
        is_boundary = first != second
        is_outside = np.delete(outside, -1, axis=axis) & np.delete(outside, 0, axis=axis)
        boundary_sum += squares[is_boundary].sum()
        expected_sum += is_boundary.sum() * squares[is_outside].mean()
    return float(boundary_sum / max(expected_sum, 1e-12))


def find_nearby(mask: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) bool outside the hole that are at most NEARBY pixels away from it."""
    return ~mask & (distance_transform_edt(~mask) <= NEARBY)


def low_band_psnr(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Return the PSNR in dB inside the hole of `image` and `truth` after a Gaussian filter."""
    low, true_low = (gaussian_filter(values.astype(np.float64), (LOW_BAND_SIGMA, LOW_BAND_SIGMA, 0.0)) for values in (image, truth))
    return min(psnr(true_low[mask], low[mask]), 99.0)


def contour_error(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Return the mean distance in pixels between the edges of `image` and of `truth` in the hole, both ways, mean over EDGE_SCALES."""
    errors = []
    for sigma in EDGE_SCALES:
        found, true = (find_edges(each.mean(axis=2), sigma, *EDGE_LIMITS)[0] for each in (image, truth))
        distances = []
        for edges, others in ((found, true), (true, found)):
            inside = edges & mask
            reach = distance_transform_edt(~others) if others.any() else np.full(mask.shape, MAX_EDGE_DISTANCE)
            distances.append(np.minimum(reach[inside], MAX_EDGE_DISTANCE))
        pooled = [each.mean() if len(each) else 0.0 for each in distances]
        errors.append(np.mean(pooled))
    return float(np.mean(errors))


def hole_flip(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Return the mean FLIP error in the hole, at 67 pixels per degree."""
    maps = flip_maps([(truth, image)])
    return float(maps[0][mask].mean())


def has_false_edge(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> bool:
    """Tell whether a part of the hole's boundary has an edge that the truth does not have."""
    false, total = 0, 0
    for axis in (0, 1):
        step, true = (np.linalg.norm(np.diff(each, axis=axis), axis=2) for each in (image, truth))
        first, second = (np.delete(mask, end, axis=axis) for end in (-1, 0))
        size = [1, 1]
        size[1 - axis] = 5
        limit = np.maximum(FALSE_EDGE * maximum_filter(true, size), MIN_FALSE_EDGE)
        is_boundary = first != second
        false, total = false + np.count_nonzero(is_boundary & (step > limit)), total + np.count_nonzero(is_boundary)
    return bool(false > MAX_FALSE_FRACTION * total)
