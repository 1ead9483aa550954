"""Mean pyramids of regularly spaced samples, and linear interpolation between samples.

Coarse voxels read a coarse pyramid level. Otherwise distant boxes would show single samples at random. Interpolation is linear along one
axis after the other, with weights that depend on the position only: every value is the same to the bit, whichever grid it belongs to.
"""

import math
from dataclasses import dataclass

import numpy as np

from .grids import lerp_axis

MAX_CHUNK_SAMPLES = 1 << 22  # samples that are averaged at once


@dataclass(frozen=True)
class AxisSamples:
    """The samples around positions along one axis.

    Attributes:
        start, stop: range of the samples that are needed; stop is exclusive.
        below, above: (N,) int64, samples next to each position, counted from start.
        weights: (2, N) float64, weights of these two samples.
    """

    start: int
    stop: int
    below: np.ndarray
    above: np.ndarray
    weights: np.ndarray


def locate_samples(positions: np.ndarray, first: int, last: int) -> AxisSamples:
    """Find the samples around positions (N,), clamped to samples `first` to `last`. Sample i spans i to i + 1."""
    clamped = np.clip(positions - 0.5, first, last)
    below = np.floor(clamped).astype(np.int64)
    above = np.minimum(below + 1, last)
    t = clamped - below
    start = int(below.min())
    return AxisSamples(start, int(above.max()) + 1, below - start, above - start, np.stack([1.0 - t, t]))


def interpolate_axis(values: np.ndarray, samples: AxisSamples, axis: int) -> np.ndarray:
    """Interpolate `values`, which hold samples `samples.start` to `samples.stop` along `axis`. Returns the same floating-point type."""
    return lerp_axis(values, samples.below, samples.above, samples.weights.astype(values.dtype), axis)


def build_pyramid(values: np.ndarray, outside: float | None) -> list[np.ndarray]:
    """Return `values` and their means over 2, 4, 8 ... samples along every axis, float32, down to a single sample.

    A missing sample of a last pair counts as `outside`, or as its neighbor where that is None. Sample i of level l begins where sample
    2^l i of the first level does.
    """
    levels = [values]
    while max(levels[-1].shape) > 1:
        levels.append(_halve(levels[-1], outside))
    return levels


def _halve(values: np.ndarray, outside: float | None) -> np.ndarray:
    half = np.empty([-(-count // 2) for count in values.shape], np.float32)
    layers = 2 * max(1, MAX_CHUNK_SAMPLES // (2 * values[0].size))
    for start in range(0, len(values), layers):
        chunk = values[start : start + layers].astype(np.float32)
        missing = [(0, count % 2) for count in chunk.shape]
        chunk = np.pad(chunk, missing, mode="edge") if outside is None else np.pad(chunk, missing, constant_values=outside)
        for axis in range(chunk.ndim):
            moved = np.moveaxis(chunk, axis, 0)
            chunk = np.moveaxis((moved[0::2] + moved[1::2]) * np.float32(0.5), 0, axis)
        half[start // 2 : start // 2 + len(chunk)] = chunk
    return half


def pyramid_level(voxel_size: float, sample_size: float, level_count: int) -> int:
    """Return the pyramid level with the largest samples that are no larger than a voxel.

    `sample_size` is the sample size of level 0. Both sizes are in the same unit.
    """
    return min(max(math.floor(math.log2(voxel_size / sample_size)), 0), level_count - 1)
