"""Distributions of patches, to tell how alike two textures are: sliced Wasserstein distances of random projections of the patches (Rabin et
al., "Wasserstein Barycenter and Its Application to Texture Mixing", 2011), computed from histograms, which can be added."""

import numpy as np

from .levels import RADIUS, Level, square_steps

PROJECTIONS = 32
BINS = 96
MAX_PATCHES = 20_000


class PatchStatistics:
    """Histograms of random projections of the 5 x 5 patches of a level, within the range of its valid patches."""

    def __init__(self, level: Level, generator: np.random.Generator) -> None:
        """Choose the projections; `level` must have a valid pixel."""
        self._level = level
        vectors = generator.standard_normal(((2 * RADIUS + 1) ** 2 * level.texture.shape[1], PROJECTIONS), np.float32)
        self._vectors = vectors / np.linalg.norm(vectors, axis=0)
        values = self._project(np.flatnonzero(level.valid), generator)
        self._lowest = values.min(axis=0)
        self._width = np.maximum((values.max(axis=0) - self._lowest) / BINS, 1e-9)

    def histograms(self, pixels: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Return the fractions (PROJECTIONS, BINS) of the patches around `pixels` (P,), or around a random sample of them."""
        if not len(pixels):
            return np.zeros((PROJECTIONS, BINS))
        values = self._project(pixels, generator)
        bins = np.clip((values - self._lowest) / self._width, 0, BINS - 1).astype(np.int64) + BINS * np.arange(PROJECTIONS)
        return np.bincount(bins.ravel(), minlength=PROJECTIONS * BINS).reshape(PROJECTIONS, BINS) / len(values)

    def distance(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the mean first Wasserstein distance between histograms (PROJECTIONS, BINS), times their sums, which must be equal."""
        return float((np.abs(np.cumsum(first - second, axis=1)).sum(axis=1) * self._width).mean())

    def _project(self, pixels: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        if len(pixels) > MAX_PATCHES:
            pixels = generator.choice(pixels, MAX_PATCHES, replace=False)
        neighbors, _ = self._level.neighbors(pixels, square_steps(RADIUS))
        return self._level.texture[neighbors].reshape(len(pixels), -1) @ self._vectors
