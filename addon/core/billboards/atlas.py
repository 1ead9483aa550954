"""Rectangle packing: lays out all quads of a level in one texture."""

import numpy as np

from ..errors import SettingsError
from .cloud import AtlasLayout

MAX_SIDE = 16384  # Texels; the largest texture that common GPUs accept.
MAX_TEXELS = 2**24  # A whole texture has at most as many texels as 4096 x 4096; their capture takes about 5 GB of memory.
GUTTER = 4  # Texels between quads: keeps two mip levels separate and is filled by dilation.
SIZE_MULTIPLE = 8  # Width and height are multiples of this, so that the first mip levels halve evenly.
PACKING_SLACK = 1.05  # Times the total area of the rectangles: the area of the square whose side is the first choice of width.


def pack(half_sizes: np.ndarray, texel_size: float, gutter: int = GUTTER) -> AtlasLayout:
    """Pack rectangles with `half_sizes` (Q, 2) into an atlas with `texel_size`, a length per texel. u runs along x.

    Each side is rounded to the nearest number of texels, at least one, so that the texels of a cloud match its area on average.

    Raises:
        SettingsError: no texture is large enough.
    """
    sizes = np.maximum(np.rint(2.0 * half_sizes / texel_size), 1).astype(np.int64)
    padded = sizes + gutter
    width = int(max(padded[:, 0].max() + gutter, np.ceil(np.sqrt(PACKING_SLACK * padded.prod(axis=1).sum()))))
    width += -width % SIZE_MULTIPLE
    area = int(padded.prod(axis=1).sum())
    height = area // width
    if width <= MAX_SIDE and area <= MAX_TEXELS:  # Packing into a wider strip would take minutes.
        positions, height = pack_skyline(padded, width - gutter)
        height += gutter + -(height + gutter) % SIZE_MULTIPLE
    if max(width, height) > MAX_SIDE:
        raise SettingsError(
            f"The quads need a texture of at least {width} x {height} texels, but the largest side is {MAX_SIDE}; use a larger Error.",
            ("error",),
        )
    if max(area, width * height) > MAX_TEXELS:
        raise SettingsError(
            f"The quads need a texture of at least {width} x {height} texels, but the limit is {MAX_TEXELS / 1e6:.1f} million; "
            "use a larger Error or Texel Size.",
            ("error", "texel_size"),
        )
    return AtlasLayout((width, height), np.column_stack([positions + gutter, sizes]).astype(np.int32), gutter)


def pack_skyline(sizes: np.ndarray, width: int) -> tuple[np.ndarray, int]:
    """Pack rectangles `sizes` (Q, 2) into a strip of `width`: bottom-left on a skyline, tallest first.

    Returns:
        Positions (Q, 2) of the lower left corners, and the height of the strip.
    """
    positions = np.zeros((len(sizes), 2), np.int64)
    skyline = np.zeros(width, np.int64)
    for index in np.lexsort((-sizes[:, 0], -sizes[:, 1])):
        rectangle_width, rectangle_height = sizes[index]
        windows = np.lib.stride_tricks.sliding_window_view(skyline, rectangle_width)
        lowest_y = windows.max(axis=1) if rectangle_width > 1 else skyline
        x = int(lowest_y.argmin())
        positions[index] = x, lowest_y[x]
        skyline[x : x + rectangle_width] = lowest_y[x] + rectangle_height
    return positions, int(skyline.max())
