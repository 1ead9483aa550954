"""Weighted sums of the photographs' colors at the texels of a tile."""

import numpy as np

NO_PHOTOGRAPH = -1


class TileColors:
    """What has been found for N texels.

    weights: (N,) float32, 0 where no photograph was added. source: (N,) int16, the photograph with the largest weight. resolution: (N,)
    float32, the largest number of pixels per unit of area of all photographs that were added.
    """

    def __init__(self, count: int) -> None:
        self._sums = np.zeros((count, 3), np.float32)
        self._largest = np.zeros(count, np.float32)
        self.weights, self.resolution = np.zeros(count, np.float32), np.zeros(count, np.float32)
        self.source = np.full(count, NO_PHOTOGRAPH, np.int16)

    @property
    def colors(self) -> np.ndarray:
        """(N, 3) float32 means, 0 where no photograph was added."""
        return self._sums / np.where(self.weights > 0.0, self.weights, 1.0)[:, None]

    def add(self, photograph: int, texels: np.ndarray, colors: np.ndarray, weights: np.ndarray, resolution: np.ndarray) -> None:
        """Add the `colors` (M, 3) of a photograph at `texels` (M,), with `weights` (M,) and a `resolution` (M,)."""
        self._sums[texels] += weights[:, None] * colors
        self.weights[texels] += weights
        self.resolution[texels] = np.maximum(self.resolution[texels], resolution)
        is_largest = weights > self._largest[texels]
        self._largest[texels[is_largest]] = weights[is_largest]
        self.source[texels[is_largest]] = photograph
