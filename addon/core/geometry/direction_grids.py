"""Directions on a square grid that a shader can look up: octahedral maps of the sphere or of its upper half, with bilinear taps."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .directions import from_hemi_octahedral, from_octahedral, hemi_octahedral_grid, octahedral_grid, to_hemi_octahedral, to_octahedral

SUBCELLS = 16  # along each side of a cell, for the sum of solid angles


@dataclass(frozen=True)
class DirectionGrid:
    """size x size directions at the cell centers of an octahedral map, or of a hemi-octahedral one (`upper`: z > 0 only).

    Index i * size + j is row i (y), column j (x) of the map, starting at (-1, -1).
    """

    size: int
    upper: bool = False

    def __len__(self) -> int:
        return self.size**2

    @cached_property
    def directions(self) -> np.ndarray:
        """(N, 3) float64 unit vectors."""
        return hemi_octahedral_grid(self.size) if self.upper else octahedral_grid(self.size)

    @cached_property
    def solid_angles(self) -> np.ndarray:
        """(N,) steradians of every cell; they sum to 4 pi, or to 2 pi for the upper half.

        An area dx dy of the octahedron |x| + |y| + |z| = 1 at the point p subtends dx dy / |p|^3.
        """
        count = self.size * SUBCELLS
        centers = (2.0 * np.arange(count) + 1.0) / count - 1.0
        points = np.stack(np.meshgrid(centers, centers), axis=-1)
        directions = from_hemi_octahedral(points) if self.upper else from_octahedral(points)
        per_area = np.abs(directions).sum(axis=-1) ** 3 * (0.5 if self.upper else 1.0)
        cells = per_area.reshape(self.size, SUBCELLS, self.size, SUBCELLS).sum(axis=(1, 3)).ravel()
        return cells * (2.0 if self.upper else 4.0) * np.pi / cells.sum()

    def to_map(self, directions: np.ndarray) -> np.ndarray:
        """Return map positions (..., 2) in -1..1. On the upper half, directions below the horizon are moved up to it."""
        if not self.upper:
            return to_octahedral(directions)
        raised = np.concatenate([directions[..., :2], np.maximum(directions[..., 2:], 0.0)], axis=-1)
        points_down = np.abs(raised).sum(axis=-1, keepdims=True) == 0.0
        return to_hemi_octahedral(np.where(points_down, [1.0, 0.0, 0.0], raised))

    def taps(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the four grid directions around each of `directions` (M, 3): indices (M, 4) int32 and bilinear weights (M, 4) that sum
        to 1."""
        cells = 0.5 * (self.to_map(directions) + 1.0) * self.size - 0.5
        low = np.floor(cells).astype(np.int64)
        t = cells - low
        columns = low[:, :1] + [0, 1, 0, 1]
        rows = low[:, 1:] + [0, 0, 1, 1]
        x, y = t[:, :1], t[:, 1:]
        weights = np.concatenate([(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y], axis=1)
        return self.indices(rows, columns), weights

    def interpolate(self, values: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Interpolate `values` (N, ...) of the grid at `directions` (M, 3): (M, ...) float32."""
        indices, weights = self.taps(directions)
        return np.einsum("mt,mt...->m...", weights, values[indices]).astype(np.float32)

    def indices(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the direction indices (int32) of map cells. Cells may lie one cell outside, where the map continues across its fold.

        The upper half has no fold: its edge is the horizon, and cells outside are clamped to it.
        """
        last = self.size - 1
        if self.upper:
            return (np.clip(rows, 0, last) * self.size + np.clip(columns, 0, last)).astype(np.int32)
        outside = (columns < 0) | (columns > last)
        rows, columns = np.where(outside, last - rows, rows), np.clip(columns, 0, last)
        outside = (rows < 0) | (rows > last)
        columns, rows = np.where(outside, last - columns, columns), np.clip(rows, 0, last)
        return (rows * self.size + columns).astype(np.int32)

    def pad(self, values: np.ndarray) -> np.ndarray:
        """Arrange `values` (N, ...) as a tile (size + 2, size + 2, ...): the map with a padding of one cell, so that a bilinear lookup
        between cell centers is correct up to the edge."""
        rows, columns = np.meshgrid(np.arange(-1, self.size + 1), np.arange(-1, self.size + 1), indexing="ij")
        return values[self.indices(rows, columns)]
