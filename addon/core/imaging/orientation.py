"""The orientation of photographs as cameras store them (EXIF tag 274): programs turn or mirror the stored image to show it upright."""

import numpy as np

UPRIGHT = 1  # The orientation of images without the tag, too.
ORIENTATIONS = range(1, 9)
SWAPPED = (5, 6, 7, 8)  # orientations that exchange rows and columns


def to_upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """Return an image (H, W, ...), row 0 at the bottom, that is stored with `orientation`, 1 to 8, as it is shown upright."""
    return from_upright(image, {6: 8, 8: 6}.get(orientation, orientation))  # The other orientations are their own inverses.


def from_upright(image: np.ndarray, orientation: int) -> np.ndarray:
    """Return an image (H, W, ...), row 0 at the bottom, that is shown upright, as it is stored with `orientation`, 1 to 8."""
    image = image[::-1]  # the tag is about images with row 0 at the top
    if orientation in SWAPPED:
        image = image.swapaxes(0, 1)
    if orientation in (3, 4, 6, 7):  # row 0 of the stored image is at the bottom or on the right
        image = image[::-1]
    if orientation in (2, 3, 7, 8):  # column 0 of the stored image is on the right or at the bottom
        image = image[:, ::-1]
    return image[::-1]
