"""Tiles of coarse levels enlarged to the resolution of the texture."""

import numpy as np


def enlarge(image: np.ndarray, levels: int) -> np.ndarray:
    """Return an image (H, W, 3) uint8 that is 2^levels as large, interpolated bilinearly between the centers of pixels."""
    from PIL import Image  # here, so that importing the core needs only NumPy and SciPy

    if levels == 0:
        return image
    height, width = image.shape[:2]
    picture = Image.fromarray(np.ascontiguousarray(image))
    return np.asarray(picture.resize((width << levels, height << levels), Image.Resampling.BILINEAR))
