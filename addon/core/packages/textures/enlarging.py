"""Tiles of coarse levels enlarged to the resolution of the texture.

Enlarged bilinearly and minified again by averaging, an image is blurred: along each axis, a pixel becomes 1/8, 3/4 and 1/8 of three, which
are the values of a quadratic B-spline. So tiles are coded as the coefficients of the spline that has their pixels.
"""

import numpy as np
from scipy import ndimage


def enlarge(image: np.ndarray, levels: int) -> np.ndarray:
    """Return an image (H, W, 3) uint8 that is 2^levels as large, interpolated bilinearly between the centers of pixels."""
    from PIL import Image  # here, so that importing the core needs only NumPy and SciPy

    if levels == 0:
        return image
    height, width = image.shape[:2]
    picture = Image.fromarray(np.ascontiguousarray(image))
    return np.asarray(picture.resize((width << levels, height << levels), Image.Resampling.BILINEAR))


def blur_as_enlarged(image: np.ndarray) -> np.ndarray:
    """Return what an image (H, W, 3) uint8 is after it was enlarged and minified to its size again."""
    blurred = image.astype(np.uint16)
    for _ in range(2):  # rows and columns change places twice
        padded = np.pad(blurred, ((1, 1), (0, 0), (0, 0)), mode="edge")
        blurred = (padded[:-2] + 6 * padded[1:-1] + padded[2:]).swapaxes(0, 1)
    return ((blurred + 32) >> 6).astype(np.uint8)


def sharpen_for_enlarging(tiles: np.ndarray) -> np.ndarray:
    """Return tiles (N, S, S, C) uint8 that are `tiles` after they were enlarged and minified again, up to clipping."""
    sharpened = tiles.astype(np.float32)
    for axis in (1, 2):
        sharpened = ndimage.spline_filter1d(sharpened, 2, axis, np.float32, mode="reflect")
    return np.rint(np.clip(sharpened, 0.0, 255.0)).astype(np.uint8)
