"""Rectangle packing: lays out all quads of a level in one texture.

Each quad has a rectangle of texels of its own, half a texel larger on every side: bilinear samples at its edges then read no texel of
another quad, although rectangles touch. In a mip level the same holds for rectangles that are as much larger in texels of that level, and
begin and end between two of them. Only large quads pay for that: around small ones the border would be most of the texture.
"""

import numpy as np
from scipy.ndimage import maximum_filter1d

from ..errors import SettingsError
from .cloud import AtlasLayout

MAX_SIDE = 16384  # Texels; the largest texture that common GPUs accept.
MAX_TEXELS = 2**24  # A whole texture has at most as many texels as 4096 x 4096; their capture takes about 5 GB of memory.
MIP_SIZES = (12, 48)  # Shorter side in texels from which on a quad is also separate in the first mip level, and in the second.
SIZE_MULTIPLE = 2 ** len(MIP_SIZES)  # Width and height are multiples of this, so that the first mip levels halve evenly.
FIRST_WIDTH, MIN_WIDTH, MAX_WIDTH = 1.06, 0.85, 1.25  # Widths that are tried, in sides of the square with the area of all rectangles.
MAX_WIDTHS, MAX_PLACEMENTS = 24, 8000  # Number of widths that are tried, and of rectangles that are placed altogether.


def pack(half_sizes: np.ndarray, texel_size: float) -> AtlasLayout:
    """Pack quads with `half_sizes` (Q, 2) into an atlas with `texel_size`, a length per texel. u runs along x.

    Each side is rounded to the nearest number of texels, at least one, so that the texels of a cloud match its area on average.

    Raises:
        SettingsError: no texture is large enough.
    """
    sizes = np.maximum(np.rint(2.0 * half_sizes / texel_size), 1).astype(np.int64)
    alignments = 2 ** np.searchsorted(MIP_SIZES, sizes.min(axis=1), side="right")
    padded = sizes + alignments[:, None]
    padded += -padded % alignments[:, None]
    area = int(padded.prod(axis=1).sum())
    widths = _choose_widths(padded, area)
    width, height = int(widths[0]), int(area // widths[0])
    if width <= MAX_SIDE and area <= MAX_TEXELS:  # Packing into a wider strip would take minutes.
        layouts = [pack_skyline(padded, alignments, int(width)) for width in widths]
        heights = [height + -height % SIZE_MULTIPLE for _, height in layouts]
        best = int(np.argmin(widths * heights))
        positions, width, height = layouts[best][0], int(widths[best]), heights[best]
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
    return AtlasLayout((width, height), np.column_stack([positions, padded]).astype(np.int32), sizes.astype(np.int32))


def _choose_widths(sizes: np.ndarray, area: int) -> np.ndarray:
    """Return the widths (N,) to try for rectangles `sizes` (Q, 2) with this total `area`, the most promising one first."""
    count = min(max(MAX_PLACEMENTS // len(sizes), 1), MAX_WIDTHS)
    factors = np.append(FIRST_WIDTH, np.linspace(MIN_WIDTH, MAX_WIDTH, count - 1))
    widths = np.maximum(np.ceil(factors * np.sqrt(area)), sizes[:, 0].max()).astype(np.int64)
    widths += -widths % SIZE_MULTIPLE
    return widths[np.sort(np.unique(widths, return_index=True)[1])]


def pack_skyline(sizes: np.ndarray, alignments: np.ndarray, width: int) -> tuple[np.ndarray, int]:
    """Pack rectangles `sizes` (Q, 2) into a strip of `width`: bottom-left on a skyline, most aligned and tallest first.

    alignments (Q,): powers of two that divide the sizes, and will divide the positions.

    Returns:
        Positions (Q, 2) of the lower left corners, and the height of the strip.
    """
    positions = np.zeros((len(sizes), 2), np.int64)
    skyline = np.zeros(width, np.int64)
    for index in np.lexsort((-sizes[:, 0], -sizes[:, 1], -alignments)):
        (rectangle_width, rectangle_height), alignment = sizes[index], alignments[index]
        lowest_y = maximum_filter1d(skyline, rectangle_width, origin=-(rectangle_width // 2))[: width - rectangle_width + 1 : alignment]
        lowest_y = lowest_y + -lowest_y % alignment
        column = int(lowest_y.argmin())
        x, y = column * alignment, lowest_y[column]
        positions[index] = x, y
        skyline[x : x + rectangle_width] = y + rectangle_height
    return positions, int(skyline.max())
