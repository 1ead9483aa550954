"""Terrains and aerial images for `bench_bdam.py`: fractal ones of any size, which are made row by row, and real elevation models."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from scipy import ndimage, sparse

from farfield.addon.core.bdam.building.height_grid import HeightGrid, encode_heights
from farfield.addon.core.bdam.fields.terrain_field import open_field

CELL_SIZE, HEIGHT_STEP, MAX_HEIGHT = 20.0, 0.1, 4400.0  # meters, as the Puget Sound of the paper
MEAN_HEIGHT, DEVIATION = 1800.0, 750.0  # meters, before heights are clipped
LARGEST_FEATURE = 1024  # cells; larger terrains have more mountains, not larger ones
CLIFF_HEIGHT, GENTLE = 400.0, 0.35  # meters, and the factor of the heights of ground with cliffs
BAND_ROWS = 128
BLOCK = 128  # side of a block of random numbers


@dataclass(frozen=True)
class Noise:
    """Fractional Brownian motion on an infinite grid with a standard deviation of about 1.

    It is the sum of octaves of random numbers on lattices, smoothed by cubic B-splines. hurst: how fast the octaves weaken; that of rough
    terrain is small. largest, smallest: cells between the points of the lattices.
    """

    seed: int
    hurst: float
    largest: int = LARGEST_FEATURE
    smallest: int = 1

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w) float32."""
        total = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
        weight_sum, spacing, octave = 0.0, self.largest, 0
        while spacing >= self.smallest:
            weight = (spacing / self.largest) ** self.hurst
            total += np.float32(weight) * self._read_octave(octave, spacing, rows, columns)
            weight_sum += weight * weight
            spacing, octave = spacing // 2, octave + 1
        return total / np.float32(np.sqrt(weight_sum) * SPLINE_DEVIATION)

    def _read_octave(self, octave: int, spacing: int, rows: slice, columns: slice) -> np.ndarray:
        ranges = [(axis.start // spacing, (axis.stop - 1) // spacing + 4) for axis in (rows, columns)]
        lattice = self._read_lattice(octave, *ranges)
        along, across = (
            _spline_weights(np.arange(axis.start, axis.stop), spacing, first, last - first)
            for axis, (first, last) in zip((rows, columns), ranges, strict=True)
        )
        return along @ (across @ lattice.T).T

    def _read_lattice(self, octave: int, rows: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
        """Return random numbers (h, w) float32 of a window, which are drawn in blocks."""
        blocks = [range(first // BLOCK, (last - 1) // BLOCK + 1) for first, last in (rows, columns)]
        drawn = np.block(
            [
                [np.random.default_rng([self.seed, octave, j, i]).standard_normal((BLOCK, BLOCK), np.float32) for i in blocks[1]]
                for j in blocks[0]
            ]
        )
        row, column = rows[0] - blocks[0].start * BLOCK, columns[0] - blocks[1].start * BLOCK
        return drawn[row : row + rows[1] - rows[0], column : column + columns[1] - columns[0]]


SPLINE_DEVIATION = 0.48  # White noise with a deviation of 1 has this one after smoothing along both axes: the mean over all phases.


def _spline_weights(positions: np.ndarray, spacing: int, first: int, count: int) -> sparse.csr_matrix:
    """Return the weights (P, count) of lattice points from `first` on at positions."""
    cells = positions // spacing
    t = (positions / spacing - cells)[:, None]
    weights = np.concatenate([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1) / 6.0
    columns = (cells - first)[:, None] + np.arange(4)
    starts = np.arange(0, 4 * len(positions) + 1, 4)
    return sparse.csr_matrix((weights.ravel().astype(np.float32), columns.ravel(), starts), shape=(len(positions), count))


@dataclass(frozen=True)
class FractalTerrain:
    """A square fractal terrain of `size` x `size` samples with heights from 0 to MAX_HEIGHT in whole HEIGHT_STEP. Row 0 is in the south."""

    size: int
    seed: int
    hurst: float = 0.85

    def read(self, rows: slice) -> np.ndarray:
        """Return rows (h, size) float32, meters."""
        heights = MEAN_HEIGHT + DEVIATION * Noise(self.seed, self.hurst).read(rows, slice(0, self.size))
        return (np.rint(np.clip(heights, 0.0, MAX_HEIGHT) / HEIGHT_STEP) * HEIGHT_STEP).astype(np.float32)

    def read_all(self) -> np.ndarray:
        """Return all heights (size, size) float32, meters."""
        return np.concatenate([self.read(rows) for rows in split_bands(self.size)])

    def write(self, path: Path) -> None:
        """Write a TIFF file without compression, row by row; its first row is the northern one."""
        pixels = tifffile.memmap(path, shape=(self.size, self.size), dtype=np.float32)
        for rows in split_bands(self.size):
            pixels[self.size - rows.stop : self.size - rows.start] = self.read(rows)[::-1]
        pixels.flush()


def create_cliffs(size: int, seed: int) -> np.ndarray:
    """Return heights (size, size) float32 in meters: gentle fractal ground with a winding escarpment and a mesa."""
    square = slice(0, size)
    y, x = np.mgrid[square, square].astype(np.float32)
    winding = Noise(seed + 1, 0.8, 512).read(square, square)
    is_above = (x + 0.35 * y - 0.6 * size + 60.0 * winding > 0.0).astype(np.int32)
    is_mesa = np.hypot(x - 0.25 * size, y - 0.6 * size) - 0.12 * size + 25.0 * winding < 0.0
    heights = GENTLE * FractalTerrain(size, seed).read_all() + CLIFF_HEIGHT * (is_above + is_mesa)
    return (np.rint(heights / HEIGHT_STEP) * HEIGHT_STEP).astype(np.float32)


@dataclass(frozen=True)
class AerialImage:
    """A synthetic aerial photograph of `size` x `size` pixels: soil, forest, fields with sharp borders, and the noise of a sensor.

    It is computed when it is read, an `ImageSource`. Row 0 is in the south.
    """

    size: int
    seed: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns and channels."""
        return self.size, self.size, 3

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w, 3) uint8, sRGB-encoded."""
        rows, columns = slice(*rows.indices(self.size)), slice(*columns.indices(self.size))
        cover, shade, grain = (
            Noise(self.seed + index, hurst, largest).read(rows, columns)
            for index, (hurst, largest) in enumerate(((0.8, 512), (0.1, 256), (0.0, 2)))
        )
        y, x = np.arange(rows.start, rows.stop)[:, None] // 96, np.arange(columns.start, columns.stop) // 160
        parcels = np.sin(12.9898 * x + 78.233 * y + self.seed % 97) * 43758.5453 % 1.0  # one pseudorandom number per parcel
        soil, forest, crops = (np.array(color) for color in ((0.48, 0.40, 0.31), (0.16, 0.24, 0.12), (0.55, 0.52, 0.24)))
        forest_part = np.clip(4.0 * cover, 0.0, 1.0)[..., None]
        open_land = np.where((cover < -0.4)[..., None], crops * (0.6 + 0.6 * parcels[..., None]), soil)
        colors = open_land * (1.0 - forest_part) + forest * forest_part
        colors = colors * (1.0 + 0.45 * shade[..., None]) + 0.02 * grain[..., None]
        return np.rint(255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint8)

    def write(self, path: Path) -> None:
        """Write a TIFF file without compression, row by row; its first row is the northern one."""
        pixels = tifffile.memmap(path, shape=self.shape, dtype=np.uint8, photometric="rgb")
        for rows in split_bands(self.size):
            pixels[self.size - rows.stop : self.size - rows.start] = self.read(rows, slice(0, self.size))[::-1]
        pixels.flush()


def split_bands(size: int) -> Iterator[slice]:
    """Yield the rows of a field in bands."""
    for start in range(0, size, BAND_ROWS):
        yield slice(start, min(start + BAND_ROWS, size))


def read_real(path: Path) -> tuple[np.ndarray, float]:
    """Return the heights (H, W) float32 in meters of an elevation model, row 0 in the south, and the meters between two heights.

    Voids are filled with their nearest height.
    """
    field = open_field([path])
    rows, columns = field.shape
    heights = field.read(slice(0, rows), slice(0, columns))
    is_void = ~np.isfinite(heights)
    if is_void.any():
        nearest = ndimage.distance_transform_edt(is_void, return_distances=False, return_indices=True)
        heights = heights[tuple(nearest)]
    return heights, field.height_step or HEIGHT_STEP


def write_grid(heights: np.ndarray, height_step: float, path: Path) -> HeightGrid:
    """Write heights (H, W) in meters as the grid that errors are measured against."""
    steps = np.rint(heights / height_step).astype(np.int32)
    path.write_bytes(encode_heights(steps, np.ones(steps.shape, bool)).astype("<i4").tobytes())
    return HeightGrid(path, *heights.shape)
