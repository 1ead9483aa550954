"""What the rest of the tool knows of elevation models: heights by window, and the position of grid coordinates on the ground."""

from typing import Protocol

import numpy as np


class HeightField(Protocol):
    """A grid of heights of any size.

    Grid coordinates are (x, y) = (column, row), integers at samples, row 0 in the south and column 0 in the west. The local frame is in
    meters, x east, y north, z up.

    shape: rows and columns. origin: the position of the local zero, meters of the projection, or degrees of longitude and latitude. crs:
    the coordinate reference system in words. cell_size: nominal meters between two samples, the geometric mean of both directions.
    height_step: meters between two heights that the source can tell apart; None for floats. warnings: sentences for the user.
    """

    shape: tuple[int, int]
    origin: tuple[float, float]
    crs: str
    cell_size: float
    height_step: float | None
    warnings: tuple[str, ...]

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return the heights (h, w) float32 of a window within the grid, in meters, NaN where they are unknown.

        Slices have a start and a stop, and no step. It may be called from several threads.

        Raises:
            FileError: a file is damaged or cannot be read.
        """
        ...

    def to_local(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return local meters, float64, of grid coordinates, which may be fractional or outside of the grid."""
        ...

    def to_grid(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return grid coordinates, float64, of local meters: the inverse of `to_local`."""
        ...
