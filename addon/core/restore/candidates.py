"""Comparison of candidates: how well the neighborhood of a source pixel fits the known pixels around a pixel of the hole."""

import numpy as np

from .kernels import COARSE_STEPS, COARSE_WEIGHT, FULL_STEPS
from .levels import Level

MAX_ELEMENTS = 4_000_000  # compared at once, so that memory stays bounded


def compare(level: Level, coarse: Level | None, pixels: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Return the mean squared differences (P, K) between the neighborhoods of `pixels` (P,) and of their `candidates` (P, K).

    Only filled pixels of the 5 x 5 neighborhood count, and 3 x 3 pixels of `coarse`. Candidates that are negative or not valid get
    infinity.
    """
    channels = level.texture.shape[1]
    chunk = max(1, MAX_ELEMENTS // (candidates.shape[1] * len(FULL_STEPS) * channels))
    parts = [
        _compare(level, coarse, pixels[start : start + chunk], candidates[start : start + chunk]) for start in range(0, len(pixels), chunk)
    ]
    return np.concatenate(parts) if parts else np.zeros(candidates.shape, np.float32)


def _compare(level: Level, coarse: Level | None, pixels: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    is_valid = (candidates >= 0) & level.valid[candidates]
    sources = np.where(is_valid, candidates, np.argmax(level.valid))  # any valid pixel, for indexing
    neighbors, exists = level.neighbors(pixels, FULL_STEPS)
    weights = (exists & level.filled[neighbors]).astype(np.float32)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
    difference = level.texture[sources[:, :, None] + level.offset(FULL_STEPS)] - level.texture[neighbors][:, None]
    distance = np.einsum("pknc,pknc,pn->pk", difference, difference, weights)
    if coarse is not None:
        above = coarse.texture[coarse.neighbors(level.parents(pixels), COARSE_STEPS)[0]][:, None]
        difference = coarse.texture[level.parents(sources)[:, :, None] + coarse.offset(COARSE_STEPS)] - above
        distance += COARSE_WEIGHT / len(COARSE_STEPS) * np.einsum("pknc,pknc->pk", difference, difference)
    return np.where(is_valid, distance, np.inf)
