"""Places for all quads of a level in one texture."""

import numpy as np

from ..errors import SettingsError
from .cloud import Atlas

LARGEST = 16384
GUTTER = 4  # texels between quads: two mip levels stay apart, and dilation fills them
MULTIPLE = 8  # width and height are multiples, so that the first mip levels halve evenly


def pack(half_sizes: np.ndarray, texel: float, gutter: int = GUTTER) -> Atlas:
    """An atlas for rectangles with `half_sizes` (Q, 2) at `texel` (a length) a texel, u along x.

    A side takes the nearest whole number of texels, at least one, so that the texels of a cloud are on the mean its area.

    Raises:
        SettingsError: when no texture is large enough.
    """
    sizes = np.maximum(np.rint(2.0 * half_sizes / texel), 1).astype(np.int64)
    padded = sizes + gutter
    width = int(max(padded[:, 0].max() + gutter, np.ceil(np.sqrt(1.05 * padded.prod(axis=1).sum()))))
    width += -width % MULTIPLE
    height = int(padded.prod(axis=1).sum() // width)
    if width <= LARGEST:  # looking for places in more than that takes minutes
        places, height = skyline(padded, width - gutter)
        height += gutter + -(height + gutter) % MULTIPLE
    if max(width, height) > LARGEST:
        raise SettingsError(
            f"The quads need a texture of at least {width} x {height} texels and {LARGEST} is the largest side; take a larger error."
        )
    return Atlas((width, height), np.column_stack([places + gutter, sizes]).astype(np.int32), gutter)


def skyline(sizes: np.ndarray, width: int) -> tuple[np.ndarray, int]:
    """Places (Q, 2) of rectangles `sizes` (Q, 2) in a strip of `width`, and its height: bottom-left on a skyline, tallest first."""
    places = np.zeros((len(sizes), 2), np.int64)
    tops = np.zeros(width, np.int64)
    for index in np.lexsort((-sizes[:, 0], -sizes[:, 1])):
        wide, tall = sizes[index]
        resting = np.lib.stride_tricks.sliding_window_view(tops, wide).max(axis=1) if wide > 1 else tops
        x = int(resting.argmin())
        places[index] = x, resting[x]
        tops[x : x + wide] = resting[x] + tall
    return places, int(tops.max())
