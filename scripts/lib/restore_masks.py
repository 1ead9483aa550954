"""Masks of a restoration: from an image file, from alpha, or from a color."""

import re
from pathlib import Path

import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.imaging.image_files import read_image_file
from farfield.addon.bridge.imaging.image_storage import ImageFile
from farfield.addon.core.errors import ImageError
from farfield.addon.core.imaging.colors import LUMINANCE
from farfield.addon.core.imaging.orientation import SWAPPED, UPRIGHT, from_upright

ALPHA = "alpha"  # instead of the path of a mask
COLOR = re.compile(r"#([0-9a-fA-F]{6})")
THRESHOLD = 0.5


def is_mask_file(mask: str) -> bool:
    """Whether the argument MASK is the path of a file, not a color or the word for alpha."""
    return mask != ALPHA and COLOR.fullmatch(mask) is None


def masked_pixels(mask: str, image: ImageFile, path: Path, tolerance: float) -> np.ndarray:
    """Return the pixels (H, W) bool of the image read from `path` that the argument MASK, the word for alpha or a color, selects.

    tolerance: largest difference of a channel from the color, 0 to 1.

    Raises:
        ImageError: the image has no alpha.
    """
    if mask == ALPHA:
        if not image.storage.has_alpha:
            raise ImageError(f'"{path}" has no alpha channel; give the path of a mask or a color instead of "{ALPHA}".')
        return image.pixels[..., -1] <= 0.0
    color = np.array([int(mask[start : start + 2], 16) / 255.0 for start in (1, 3, 5)], np.float32)
    colors = _colors(image)
    limit = tolerance + 0.5 / 65535  # equal values differ by less than one step of 16 bits
    return np.logical_and.reduce([np.abs(colors[..., channel % colors.shape[2]] - color[channel]) <= limit for channel in range(3)])


def read_mask(path: Path, image: ImageFile, image_path: Path, name: str) -> tuple[np.ndarray, str | None]:
    """Return the bright pixels (H, W) bool of a mask file: their luminance is more than a half of white. Transparent pixels are not bright.

    Cameras store photographs with an orientation; a mask without one was painted on the upright photograph, and is turned. It is used as it
    is if its orientation, or a size that fits only then, says so. Also returns a sentence if it was turned.

    image: which the mask belongs to. name: of the mask in messages.

    Raises:
        FileError: the file cannot be read.
        ImageError: its size is not that of the image, or it contains NaN.
    """
    mask = read_image_file(path, is_color=False)
    height, width = mask.pixels.shape[:2]
    rows, columns = image.pixels.shape[:2]
    fitting = (columns, rows) if image.orientation in SWAPPED and mask.orientation == UPRIGHT else (rows, columns)
    is_turned = mask.orientation == UPRIGHT != image.orientation and (height, width) == fitting
    if not is_turned and (height, width) != (rows, columns):
        stored = "" if image.orientation == UPRIGHT else f", stored with the orientation {image.orientation}"
        raise ImageError(
            f'The {name} "{path}" has {width} x {height} pixels and the image "{image_path}" {columns} x {rows}{stored}; '
            "they must have the same size."
        )
    if np.isnan(mask.pixels).any():
        raise ImageError(f'The {name} "{path}" has pixels that are not numbers (NaN); save it again.')
    colors = _colors(mask)
    luminance = colors @ LUMINANCE if colors.shape[2] == 3 else colors[..., 0]
    if mask.storage.has_alpha and mask.format != "openexr":  # whose colors are multiplied by alpha already
        luminance = luminance * mask.pixels[..., -1]
    bright = luminance > THRESHOLD
    if not is_turned:
        return bright, None
    remark = f"The {name} was turned as the image is stored, with the orientation {image.orientation}."
    return from_upright(bright, image.orientation), remark


def _colors(image: ImageFile) -> np.ndarray:
    """Return the colors (H, W, 1 or 3) of an image without alpha or further channels."""
    count = image.pixels.shape[2] - image.storage.has_alpha
    return image.pixels[..., : 3 if count >= 3 else 1]
