"""Directions on a square grid that a shader can look up: octahedral maps of the sphere or of its upper half, with bilinear taps."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .directions import (
    from_hemi_octahedral,
    from_octahedral,
    hemi_octahedral_grid,
    octahedral_grid,
    to_hemi_octahedral,
    to_octahedral,
)

FINE = 16  # sub-cells along each side of a cell when solid angles are summed


@dataclass(frozen=True)
class DirectionGrid:
    """size x size directions at the cell centres of an octahedral map, or of a hemi-octahedral one (`upper`: z > 0 only).

    Number i * size + j is row i (y), column j (x) of the map, from (-1, -1) on.
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
        """(N,) steradians of every cell, 4 pi in all, or 2 pi for the upper half.

        A place p on the octahedron |x| + |y| + |z| = 1 sees dx dy under dx dy / |p|^3.
        """
        fine = self.size * FINE
        centres = (2.0 * np.arange(fine) + 1.0) / fine - 1.0
        points = np.stack(np.meshgrid(centres, centres), axis=-1)
        directions = from_hemi_octahedral(points) if self.upper else from_octahedral(points)
        per_area = np.abs(directions).sum(axis=-1) ** 3 * (0.5 if self.upper else 1.0)
        cells = per_area.reshape(self.size, FINE, self.size, FINE).sum(axis=(1, 3)).ravel()
        return cells * (2.0 if self.upper else 4.0) * np.pi / cells.sum()

    def places(self, directions: np.ndarray) -> np.ndarray:
        """Places (..., 2) in -1..1 on the map. On the upper half, what lies below the horizon counts as on it."""
        if not self.upper:
            return to_octahedral(directions)
        raised = np.concatenate([directions[..., :2], np.maximum(directions[..., 2:], 0.0)], axis=-1)
        straight_down = np.abs(raised).sum(axis=-1, keepdims=True) == 0.0
        return to_hemi_octahedral(np.where(straight_down, [1.0, 0.0, 0.0], raised))

    def taps(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The four grid directions around each of `directions` (M, 3): numbers (M, 4) int32 and bilinear weights (M, 4) that sum to 1."""
        cells = 0.5 * (self.places(directions) + 1.0) * self.size - 0.5
        low = np.floor(cells).astype(np.int64)
        share = cells - low
        columns = low[:, :1] + [0, 1, 0, 1]
        rows = low[:, 1:] + [0, 0, 1, 1]
        x, y = share[:, :1], share[:, 1:]
        weights = np.concatenate([(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y], axis=1)
        return self.numbers(rows, columns), weights

    def interpolated(self, values: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """`values` (N, ...) of the grid's directions at `directions` (M, 3): (M, ...) float32."""
        numbers, weights = self.taps(directions)
        return np.einsum("mt,mt...->m...", weights, values[numbers]).astype(np.float32)

    def numbers(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """The directions at cells of the map, which may lie one cell outside: there the map goes on across its fold, int32.

        The upper half has no fold; its rim is the horizon and goes on with itself.
        """
        last = self.size - 1
        if self.upper:
            return (np.clip(rows, 0, last) * self.size + np.clip(columns, 0, last)).astype(np.int32)
        beside = (columns < 0) | (columns > last)
        rows, columns = np.where(beside, last - rows, rows), np.clip(columns, 0, last)
        beyond = (rows < 0) | (rows > last)
        columns, rows = np.where(beyond, last - columns, columns), np.clip(rows, 0, last)
        return (rows * self.size + columns).astype(np.int32)

    def bordered(self, values: np.ndarray) -> np.ndarray:
        """`values` (N, ...) as tiles (size + 2, size + 2, ...): the map with a border one cell wide, so that a bilinear look-up between
        cell centres is right up to the rim."""
        rows, columns = np.meshgrid(np.arange(-1, self.size + 1), np.arange(-1, self.size + 1), indexing="ij")
        return values[self.numbers(rows, columns)]
