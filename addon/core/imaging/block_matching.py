"""Displacements between two images of the same thing, block by block, by phase correlation from coarse to fine.

Phase correlation after Kuglin and Hines, "The Phase Correlation Image Alignment Method" (1975), with windowed, high-passed blocks. The
image is warped by what coarser levels have found before its blocks are compared, so that the shifts which remain are small; a second
comparison at the finest level removes the bias of windows and of the interpolated peak.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft2, rfft2
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter

from .pyramids import reduce_weighted

BLOCK, STRIDE = 64, 32  # pixels of a block and between two of them, at every level
CHUNK = 256  # blocks at once


@dataclass(frozen=True)
class Tuning:
    """Numbers of the method; lengths are pixels of a level."""

    max_levels: int = 3  # With max_step, displacements of up to about 64 pixels are found.
    max_step: int = 16  # Largest shift that a level finds.
    fine_passes: int = 2  # Comparisons at the finest level.
    high_pass: float = 8.0  # Standard deviation of what is subtracted from blocks.
    peak_width: float = 0.9  # Standard deviation of the peak of a perfect match.
    whitening: float = 10.0  # Times the mean spectrum is added to it, so that frequencies with little but noise count little.
    min_roundness: float = 0.03  # Smallest relative to largest curvature of a peak: along an edge, a displacement is not certain.
    max_second: float = 0.8  # A second peak that is higher, relative to the highest one, makes the displacement ambiguous.
    min_correlation: float = 0.4  # Normalized correlation of a match.
    min_coverage: float = 0.4  # Known part of a block, weighted by its window.
    min_contrast: float = 2e-3  # Standard deviation of a high-passed block; less is rounding.
    max_residual: float = 2.0  # Largest difference between a displacement and those around it.
    smoothing: float = 1.0  # Standard deviation, in blocks, of the displacements by which the image is warped.


TUNING = Tuning()


class BlockMatches(NamedTuple):
    """N blocks: centers (N, 2) and displacements (N, 2), x and y in pixels from the lower left corner: what the reference shows at a center
    lies in the image at the center plus the displacement. confidences: (N,) 0 to 1, the normalized correlation."""

    centers: np.ndarray
    displacements: np.ndarray
    confidences: np.ndarray


class _Grid(NamedTuple):
    """Measurements of a grid of blocks: displacements (R, C, 2) and weights (R, C)."""

    displacements: np.ndarray
    weights: np.ndarray


def match_blocks(reference: np.ndarray, image: np.ndarray, known: np.ndarray, image_known: np.ndarray) -> BlockMatches:
    """Return the displacements between a `reference` and an `image`, both (H, W) float32, at blocks that show the same in both.

    known, image_known: (H, W) bool, the usable pixels of both.
    """
    levels = [(reference, known.astype(np.float32), image, image_known.astype(np.float32))]
    while len(levels) < TUNING.max_levels and min(levels[-1][0].shape) >= BLOCK:
        levels.append(_reduce(*levels[-1]))
    field = np.zeros((*levels[-1][0].shape, 2), np.float32)
    for index in reversed(range(len(levels))):
        shape = levels[index][0].shape
        if field.shape[:2] != shape:
            field = 2.0 * _sample(field, *(0.5 * np.mgrid[: shape[0], : shape[1]]))
        for _ in range(1 if index else TUNING.fine_passes):
            grid = _measure(*levels[index], field)
            field = _sample(_smooth(grid), *((np.mgrid[: shape[0], : shape[1]] - STRIDE // 2) / STRIDE))
    rows, columns = _block_centers(reference.shape)
    kept = grid.weights > 0.0
    return BlockMatches(np.stack([columns[kept], rows[kept]], axis=1) + 0.5, grid.displacements[kept], grid.weights[kept])


def _reduce(reference: np.ndarray, known: np.ndarray, image: np.ndarray, image_known: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return both images and their weights at half the size."""
    first, first_known = reduce_weighted(reference[..., None], known)
    second, second_known = reduce_weighted(image[..., None], image_known)
    return first[..., 0], first_known, second[..., 0], second_known


def _block_centers(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column (R, C) of the pixel at the center of each block; the last ones may lie less than half a step outside."""
    rows, columns = (np.arange(max(round(side / STRIDE), 1)) * STRIDE + STRIDE // 2 for side in shape)
    return tuple(np.meshgrid(rows, columns, indexing="ij"))


def _sample(field: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return a field (h, w, 2) at fractional indices (H, W)."""
    return np.stack([map_coordinates(field[..., axis], (rows, columns), np.float32, 1, "nearest") for axis in (0, 1)], axis=-1)


def _measure(reference: np.ndarray, known: np.ndarray, image: np.ndarray, image_known: np.ndarray, field: np.ndarray) -> _Grid:
    """Return the displacements of all blocks of a level, after the image has been warped by `field` (H, W, 2)."""
    rows, columns = np.mgrid[: field.shape[0], : field.shape[1]]
    where = (rows + field[..., 1], columns + field[..., 0])
    warped = map_coordinates(image, where, np.float32, 3, "nearest")
    mask = ((known > 0.5) & (map_coordinates(image_known, where, np.float32, 1, "constant") > 0.5)).astype(np.float32)
    centers = _block_centers(reference.shape)
    shifts, confidences = _correlate(_high_pass(reference, mask), _high_pass(warped, mask), mask, *(each.ravel() for each in centers))
    displacements = _sample(field, *centers) + shifts.reshape(*centers[0].shape, 2)
    weights = confidences.reshape(centers[0].shape)
    expected = _smooth(_Grid(displacements, weights))
    is_near = np.linalg.norm(displacements - expected, axis=-1) <= TUNING.max_residual
    return _Grid(displacements, np.where(is_near, weights, np.float32(0.0)))


def _high_pass(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return an image minus the means of the usable pixels around each; zero where it is not usable."""
    weights = gaussian_filter(mask, TUNING.high_pass, mode="constant")
    return mask * (image - gaussian_filter(mask * image, TUNING.high_pass, mode="constant") / np.maximum(weights, 1e-6))


def _correlate(
    first: np.ndarray, second: np.ndarray, mask: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the shifts (N, 2) float32 from `first` to `second` (H, W) of the blocks around N pixels, and their confidences (N,)."""
    half = BLOCK // 2
    stack = [np.pad(each, ((half, BLOCK), (half, BLOCK))) for each in (first, second, mask)]
    window = np.hanning(BLOCK + 2)[1:-1].astype(np.float32)
    window = np.outer(window, window)
    shifts, confidences = np.zeros((len(rows), 2), np.float32), np.zeros(len(rows), np.float32)
    coverage = np.array(
        [(window * stack[2][row : row + BLOCK, column : column + BLOCK]).sum() for row, column in zip(rows, columns, strict=True)]
    )
    used = np.flatnonzero(coverage >= TUNING.min_coverage * window.sum())
    for start in range(0, len(used), CHUNK):
        part = used[start : start + CHUNK]
        a, b = (
            np.stack([each[row : row + BLOCK, column : column + BLOCK] for row, column in zip(rows[part], columns[part], strict=True)])
            * window
            for each in stack[:2]
        )
        shifts[part], confidences[part] = _find_peaks(a, b)
    return shifts, confidences


def _find_peaks(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the shifts (N, 2) between blocks (N, B, B), and the normalized correlations (N,) there, 0 if a shift is not certain."""
    energy = np.sqrt(np.square(first).sum(axis=(1, 2)) * np.square(second).sum(axis=(1, 2)))
    spectrum = np.conj(rfft2(first)) * rfft2(second)
    magnitude = np.abs(spectrum)
    frequencies = np.square(np.fft.fftfreq(BLOCK))[:, None] + np.square(np.fft.rfftfreq(BLOCK))
    low_pass = np.exp(-2.0 * np.square(np.pi * TUNING.peak_width) * frequencies).astype(np.float32)
    floor = TUNING.whitening * magnitude.mean(axis=(1, 2), keepdims=True)
    phases = _search(irfft2(spectrum * low_pass / np.maximum(magnitude + floor, 1e-20), (BLOCK, BLOCK)))
    inner = phases[:, 1:-1, 1:-1].reshape(len(phases), -1)
    best = inner.argmax(axis=1)
    rows, columns = best // (2 * TUNING.max_step - 1) + 1, best % (2 * TUNING.max_step - 1) + 1
    index = np.arange(len(phases))
    peak = phases[index, rows, columns]
    is_maximum = phases == maximum_filter(phases, (1, 3, 3), mode="constant", cval=-np.inf)
    is_maximum[index, rows, columns] = False
    second_peak = np.where(is_maximum, phases, 0.0).max(axis=(1, 2))
    shifts = np.stack([columns, rows], axis=1) - float(TUNING.max_step)
    for axis, (before, after) in enumerate(
        (
            (phases[index, rows, columns - 1], phases[index, rows, columns + 1]),
            (phases[index, rows - 1, columns], phases[index, rows + 1, columns]),
        )
    ):
        curvature = 2.0 * peak - before - after
        shifts[:, axis] += np.clip(0.5 * (after - before) / np.maximum(curvature, 1e-12), -0.5, 0.5)
    is_round = _roundness(phases, index, rows, columns) > TUNING.min_roundness
    correlation = _search(irfft2(spectrum, (BLOCK, BLOCK)))[index, rows, columns] / np.maximum(energy, 1e-12)
    is_certain = (peak > 0.0) & is_round & (second_peak < TUNING.max_second * peak) & (correlation > TUNING.min_correlation)
    has_contrast = energy > np.square(TUNING.min_contrast * BLOCK)
    return shifts, np.where(is_certain & has_contrast, np.clip(correlation, 0.0, 1.0), 0.0)


def _roundness(values: np.ndarray, index: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the smaller relative to the larger principal curvature (N,) of `values` (N, S, S) at a maximum of each."""
    at = {(row, column): values[index, rows + row, columns + column] for row in (-1, 0, 1) for column in (-1, 0, 1)}
    along_columns, along_rows = 2.0 * at[0, 0] - at[0, -1] - at[0, 1], 2.0 * at[0, 0] - at[-1, 0] - at[1, 0]
    mixed = 0.25 * (at[1, 1] + at[-1, -1] - at[1, -1] - at[-1, 1])
    mean, spread = 0.5 * (along_columns + along_rows), np.hypot(0.5 * (along_columns - along_rows), mixed)
    return (mean - spread) / np.maximum(mean + spread, 1e-12)


def _search(correlations: np.ndarray) -> np.ndarray:
    """Return the part (N, 2 S + 1, 2 S + 1) of cyclic correlations (N, B, B) with shifts of up to S = max_step, the smallest ones first."""
    steps = np.arange(-TUNING.max_step, TUNING.max_step + 1)
    return correlations[:, steps[:, None], steps]


def _smooth(grid: _Grid) -> np.ndarray:
    """Return displacements (R, C, 2) everywhere, smoothed; those of blocks without a match come from farther and farther around."""
    result, total = np.zeros_like(grid.displacements), np.full((*grid.weights.shape, 1), 1e-9)
    values = np.concatenate([grid.displacements * grid.weights[..., None], grid.weights[..., None]], axis=-1)
    for deviation, fraction in ((TUNING.smoothing, 1.0), (4.0 * TUNING.smoothing, 1e-2), (16.0 * TUNING.smoothing, 1e-4)):
        sums = fraction * gaussian_filter(values, (deviation, deviation, 0.0), mode="constant")
        result, total = result + sums[..., :2], total + sums[..., 2:]
    return (result / total).astype(np.float32)
