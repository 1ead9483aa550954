"""The pyramid of a texture on which synthesis works, and the neighborhoods of its pixels.

The canvas of a level stacks pages: windows around holes, and further parts of the image to copy from. Pages are padded so that pixel (y, x)
of one level belongs to pixel (y // 2, x // 2) of the next coarser one, and padding separates them. A pixel is identified by its flat index
y * width + x.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter

from ..imaging.pyramids import reduce_image, reduce_mask

RADIUS = 2  # Neighborhoods at the finest level have 5 x 5 pixels.
SEPARATOR = 2 * RADIUS + 2  # pixels of padding between two pages at the coarsest level
SIDES = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])  # rows and columns to the neighbors of a pixel


@dataclass(frozen=True)
class Page:
    """A part of an image.

    Attributes:
        texture: (H, W, C) float32.
        hole: (H, W) bool, pixels to fill.
        known: (H, W) bool, pixels that are not missing.
        usable: (H, W) bool, those of them that may be copied.
        wrap: whether opposite borders are neighbors, along rows and columns.
    """

    texture: np.ndarray
    hole: np.ndarray
    known: np.ndarray
    usable: np.ndarray
    wrap: tuple[bool, bool] = (False, False)


@dataclass
class Level:
    """One level of the pyramid of all P pages.

    Attributes:
        shape: (H, W) of the canvas.
        page_of_row: (H,) int.
        tops: (P,) first row of each page.
        sizes: (P, 2) rows and columns of each page without padding.
        wraps: (P, 2) bool, whether opposite borders of the page are neighbors.
        texture: (H * W, C) float32, changed by synthesis.
        hole: (H * W,) bool, pixels to fill.
        filled: (H * W,) bool, pixels whose texture is known or synthesized.
        valid: (H * W,) bool, pixels that may be copied and whose 5 x 5 neighborhood may be, too.
        source: (H * W,) int64, the pixel that was copied to a pixel of the hole, -1 for none.
    """

    shape: tuple[int, int]
    page_of_row: np.ndarray
    tops: np.ndarray
    sizes: np.ndarray
    wraps: np.ndarray
    texture: np.ndarray
    hole: np.ndarray
    filled: np.ndarray
    valid: np.ndarray
    source: np.ndarray

    def parents(self, pixels: np.ndarray, levels_up: int = 1) -> np.ndarray:
        """Return the pixels to which `pixels` belong `levels_up` levels above."""
        y, x = np.divmod(pixels, self.shape[1])
        return (y >> levels_up) * (self.shape[1] >> levels_up) + (x >> levels_up)

    def offset(self, steps: np.ndarray) -> np.ndarray:
        """Return the differences of flat indices of `steps` (..., 2), rows and columns."""
        return steps[..., 0] * self.shape[1] + steps[..., 1]

    def neighbors(self, pixels: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the neighbors (P, K) of `pixels` (P,) at `steps` (K, 2) or (P, K, 2) within their pages, and whether they exist (P, K).

        A neighbor beyond the border is replaced by the nearest pixel of the page.
        """
        y, x = np.divmod(pixels, self.shape[1])
        pages = self.page_of_row[y]
        tops = self.tops[pages][:, None]
        rows, rows_exist = self._limit(y[:, None] - tops + steps[..., 0], pages, 0)
        columns, columns_exist = self._limit(x[:, None] + steps[..., 1], pages, 1)
        return (rows + tops) * self.shape[1] + columns, rows_exist & columns_exist

    def page(self, index: int) -> np.ndarray:
        """Return the texture (H, W, C) of a page."""
        canvas = self.texture.reshape(*self.shape, -1)
        return canvas[self.tops[index] : self.tops[index] + self.sizes[index, 0], : self.sizes[index, 1]]

    def pixels(self, index: int) -> np.ndarray:
        """Return the pixels (H * W,) of a page."""
        height, width = self.sizes[index]
        return ((self.tops[index] + np.arange(height))[:, None] * self.shape[1] + np.arange(width)).ravel()

    def copy(self, pixels: np.ndarray, sources: np.ndarray) -> None:
        """Copy texture to `pixels` (P,) from their `sources` (P,)."""
        self.source[pixels] = sources
        self.texture[pixels] = self.texture[sources]

    def _limit(self, positions: np.ndarray, pages: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Return `positions` (P, K) within the sizes of their `pages` (P,) along `axis`, wrapped or clipped, and whether they exist."""
        sizes = self.sizes[pages, axis][:, None]
        exists = (positions >= 0) & (positions < sizes)
        if self.wraps[:, axis].any():
            wraps = self.wraps[pages, axis][:, None]
            return np.where(wraps, positions % sizes, np.clip(positions, 0, sizes - 1)), exists | wraps
        return np.minimum(np.maximum(positions, 0), sizes - 1), exists


def build_levels(pages: list[Page], count: int) -> list[Level]:
    """Return the levels of `pages` from fine to coarse: `count`, or fewer if nothing can be copied at coarser ones."""
    block = 2 ** (count - 1)
    width = max(page.hole.shape[1] for page in pages)
    width += -width % block
    heights = [page.hole.shape[0] + -page.hole.shape[0] % block + SEPARATOR * block for page in pages]
    levels = []
    for index in range(count):
        if index:
            pages = [_reduce(page) for page in pages]
        level = _stack(pages, [height >> index for height in heights], width >> index)
        if index and not level.valid.any():
            break
        levels.append(level)
    return levels


def _reduce(page: Page) -> Page:
    """Return a page at half the size. Pixels that the kernel connects with pixels to fill are filled as well (section 5.4)."""
    return Page(
        reduce_image(page.texture, page.wrap),
        reduce_mask(page.hole, page.wrap),
        ~reduce_mask(~page.known, page.wrap),
        ~reduce_mask(~page.usable, page.wrap),
        page.wrap,
    )


def _stack(pages: list[Page], heights: list[int], width: int) -> Level:
    tops = np.concatenate([[0], np.cumsum(heights)])
    shape = (int(tops[-1]), width)
    texture = np.zeros((*shape, pages[0].texture.shape[2]), np.float32)
    hole, known, usable = (np.zeros(shape, bool) for _ in range(3))
    for page, top in zip(pages, tops, strict=False):
        area = (slice(top, top + page.hole.shape[0]), slice(0, page.hole.shape[1]))
        texture[area], hole[area], known[area], usable[area] = page.texture, page.hole, page.known, page.usable
    return Level(
        shape=shape,
        page_of_row=np.repeat(np.arange(len(pages)), heights),
        tops=tops[:-1],
        sizes=np.array([page.hole.shape for page in pages]),
        wraps=np.array([page.wrap for page in pages]),
        texture=texture.reshape(-1, texture.shape[2]),
        hole=hole.ravel(),
        filled=(known & ~hole).ravel(),
        valid=minimum_filter(usable, 2 * RADIUS + 1, mode="constant").ravel(),
        source=np.full(hole.size, -1, np.int64),
    )


def square_steps(radius: int) -> np.ndarray:
    """Return the rows and columns (K, 2) of all pixels of a square, relative to its center."""
    grid = np.arange(-radius, radius + 1)
    return np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
