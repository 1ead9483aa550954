"""Normals of all samples as an image, from which the tiles of normal maps are made.

The tiles are those of textures (see `textures.store`), in the lossless format, and averaged like colors: red and green, scene-linear, are
0.5 + 0.5 n of the components n of unit normals along x and y of the local frame, without exaggeration; blue is 0.5. Means of directions
keep what shading sees of relief that is finer than a texel. Heights that are unknown are interpolated, so every texel has a normal.
"""

import numpy as np

from ...geometry.placements import Frame
from .height_grid import HeightGrid


class SampleNormals:
    """An image source of `textures.resampling`: a pixel per sample of a field."""

    def __init__(self, grid: HeightGrid, frame: Frame, height_step: float) -> None:
        self.shape = (grid.rows, grid.columns, 3)
        self._grid, self._frame, self._height_step = grid, frame, height_step

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w, 3) float32. Raises FileError."""
        top, left = max(rows.start - 1, 0), max(columns.start - 1, 0)
        heights, _ = self._grid.read(slice(top, min(rows.stop + 1, self.shape[0])), slice(left, min(columns.stop + 1, self.shape[1])))
        along_y, along_x = np.gradient(heights * self._height_step)
        inner = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
        gradients = np.stack([along_x[inner], along_y[inner]], axis=-1).reshape(-1, 2)
        y, x = np.mgrid[rows, columns].reshape(2, -1)
        gradients = self._frame.to_local_gradients(x, y, gradients)
        pixels = np.full((len(gradients), 3), 0.5, np.float32)
        pixels[:, :2] -= 0.5 * gradients / np.sqrt(1.0 + (gradients * gradients).sum(axis=1, keepdims=True))
        return pixels.reshape(*heights[inner].shape, 3)
