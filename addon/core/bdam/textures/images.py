"""Images of a terrain's surface, read by window, and where they lie on the field."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from ...errors import ImageError
from ...files.scratch import Scratch
from ...imaging.coded_images import read_coded_image

MAX_SHEAR = 1e-3  # pixels, over the whole image, of a rotation that counts as none


class ImageSource(Protocol):
    """An image that is read by window.

    Attributes:
        shape: rows, columns and channels; 3 for RGB, 4 with alpha.
    """

    shape: tuple[int, int, int]

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (H, W, channels) with straight alpha: uint8, sRGB-encoded, or float32, scene-linear. NaN is unknown.

        Raises:
            FileError: the file cannot be read.
        """


class ArraySource:
    """An image that is an array (H, W, 3 or 4), also a mapped one."""

    def __init__(self, pixels: np.ndarray) -> None:
        if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or not pixels.size:
            raise ImageError(f"An image for texture has the shape {pixels.shape}; give one with 3 or 4 channels.")
        if pixels.dtype != np.uint8 and pixels.dtype.kind != "f":
            raise ImageError(f"An image for texture has pixels of type {pixels.dtype}; give 8 bits or floats.")
        self.shape = pixels.shape
        self._pixels = pixels

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window of the array."""
        return self._pixels[rows, columns]


def open_coded_image(path: Path, scratch: Scratch, group: int = 0) -> ArraySource:
    """Decode a JPEG, PNG or WebP file once into `scratch`, which keeps large images in a mapped file. Row 0 is the bottom one.

    Raises:
        ImageError: the file is no such image, is damaged, or has more than `coded_images.MAX_PIXELS` pixels.
        FileError: the temporary file cannot be written.
        OSError: the file cannot be read.
    """
    return ArraySource(scratch.keep(read_coded_image(path), group))


@dataclass(frozen=True)
class PlacedImage:
    """An image on the field.

    Attributes:
        source: the pixels.
        corner: grid coordinates (x, y) of the outer corner of pixel (row 0, column 0).
        step: cells from one column to the next along x, and from one row to the next along y; negative where rows or columns run
            downwards. Images of files whose row 0 is the northern one have a negative step along y.
    """

    source: ImageSource
    corner: tuple[float, float]
    step: tuple[float, float]

    @property
    def pixel(self) -> float:
        """The shorter side of a pixel in cells."""
        return min(abs(self.step[0]), abs(self.step[1]))

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest grid coordinate of the image along x, and along y."""
        counts = self.source.shape[1::-1]
        ends = [(start, start + step * count) for start, step, count in zip(self.corner, self.step, counts, strict=True)]
        return tuple((min(pair), max(pair)) for pair in ends)


def stretch_over_field(source: ImageSource, columns: int, rows: int) -> PlacedImage:
    """Place an image whose row 0 is the southern one over the whole field of columns x rows samples."""
    height, width, _ = source.shape
    return PlacedImage(source, (0.0, 0.0), ((columns - 1) / width, (rows - 1) / height))


def place_by_affine(
    source: ImageSource, pixel_to_local: np.ndarray, field_corner: tuple[float, float], spacing: tuple[float, float]
) -> PlacedImage:
    """Return the `PlacedImage` of a georeferenced image.

    pixel_to_local: (2, 3) float64, from (column, row, 1) of pixel corners to local meters (x east, y north).
    field_corner: local meters of sample (0, 0). spacing: meters between neighboring samples along x and y.

    Raises:
        ImageError: the image is rotated or has no area.
    """
    matrix = np.asarray(pixel_to_local, np.float64)
    steps = np.diag(matrix[:, :2])
    shear = np.abs(matrix[[0, 1], [1, 0]]) * source.shape[:2]  # meters over all rows, and over all columns
    if not np.isfinite(matrix).all() or (steps == 0.0).any() or (shear > MAX_SHEAR * np.abs(steps)).any():
        raise ImageError("An image for texture is rotated or has no size on the ground; rotate it upright in a GIS and save it again.")
    corner = (matrix[:, 2] - field_corner) / spacing
    step = steps / spacing
    return PlacedImage(source, (float(corner[0]), float(corner[1])), (float(step[0]), float(step[1])))
