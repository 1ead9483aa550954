"""The pyramid of a texture on which synthesis works, and the neighborhoods of its pixels.

The canvas of a level stacks pages: the first is the window around a hole, others are further parts of the image to copy from. Pages are
padded so that pixel (y, x) of one level belongs to pixel (y // 2, x // 2) of the next coarser one, and padding separates them. A pixel is
identified by its flat index y * width + x.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter

from ..imaging.pyramids import reduce_image, reduce_mask

RADIUS = 2  # of the 5 x 5 neighborhoods of the finest level
SEPARATOR = 2 * RADIUS + 2  # pixels of padding between two pages at the coarsest level


@dataclass(frozen=True)
class Page:
    """A part of an image. texture: (H, W, C) float32. hole, usable: (H, W) bool, pixels to fill, and pixels that may be copied."""

    texture: np.ndarray
    hole: np.ndarray
    usable: np.ndarray


@dataclass
class Level:
    """One level of the pyramid of all pages.

    shape: (H, W) of the canvas. window: (H', W') of the first page without padding. wrap: whether its opposite borders are neighbors.
    texture: (H * W, C) float32, changed by synthesis. hole: (H * W) bool, pixels to fill. filled: (H * W) bool, pixels whose texture is
    known or synthesized. valid: (H * W) bool, pixels that may be copied and whose 5 x 5 neighborhood may be, too. source: (H * W) int64,
    the pixel that was copied to a pixel of the hole, -1 for none.
    """

    shape: tuple[int, int]
    window: tuple[int, int]
    wrap: tuple[bool, bool]
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
        """Return the neighbors (P, K) of `pixels` (P,) of the first page at `steps` (K, 2) or (P, K, 2), and whether they exist (P, K).

        A neighbor beyond the border is replaced by the nearest pixel that exists.
        """
        y, x = np.divmod(pixels, self.shape[1])
        exists = None
        moved = []
        for position, step, size, wraps in ((y, steps[..., 0], self.window[0], self.wrap[0]), (x, steps[..., 1], self.window[1], self.wrap[1])):
            target = position[:, None] + step
            if wraps:
                target %= size
            else:
                clipped = np.clip(target, 0, size - 1)
                is_inside = clipped == target
                exists = is_inside if exists is None else exists & is_inside
                target = clipped
            moved.append(target)
        exists = np.ones(moved[0].shape, bool) if exists is None else exists
        return moved[0] * self.shape[1] + moved[1], exists


def build_levels(pages: list[Page], count: int, wrap: tuple[bool, bool]) -> list[Level]:
    """Return the levels of `pages`, which have equal widths, from fine to coarse: `count`, or fewer if nothing can be copied at coarser
    ones."""
    block = 2 ** (count - 1)
    window = pages[0].hole.shape
    padded = [_pad_page(page, block, is_last=page is pages[-1]) for page in pages]
    levels = []
    for index in range(count):
        if index:
            is_first = [True] + [False] * (len(padded) - 1)
            padded = [_reduce_page(page, window, wrap if first else (False, False)) for page, first in zip(padded, is_first, strict=True)]
            window = ((window[0] + 1) // 2, (window[1] + 1) // 2)
        level = _stack(padded, window, wrap)
        if index and not level.valid.any():
            break
        levels.append(level)
    return levels


def _pad_page(page: Page, block: int, is_last: bool) -> Page:
    """Pad a page to a multiple of `block`, with a separator below unless it is the last one."""
    height, width = page.hole.shape
    rows = -height % block + (0 if is_last else SEPARATOR * block)
    padding = ((0, rows), (0, -width % block))
    return Page(
        np.pad(page.texture, (*padding, (0, 0)), mode="edge"),
        np.pad(page.hole, padding),
        np.pad(page.usable, padding),
    )


def _reduce_page(page: Page, window: tuple[int, int], wrap: tuple[bool, bool]) -> Page:
    """Return a padded page at half the size. Pixels that the kernel connects with pixels to fill are filled as well (section 5.4)."""
    if any(wrap):  # the padding is no neighbor
        inner = Page(*(array[: window[0], : window[1]] for array in (page.texture, page.hole, page.usable)))
        reduced = Page(reduce_image(inner.texture, wrap), reduce_mask(inner.hole, wrap), ~reduce_mask(~inner.usable, wrap))
        shape = (page.hole.shape[0] // 2, page.hole.shape[1] // 2)
        padding = tuple((0, size - part) for size, part in zip(shape, reduced.hole.shape, strict=True))
        texture = np.pad(reduced.texture, (*padding, (0, 0)), mode="edge")
        return Page(texture, np.pad(reduced.hole, padding), np.pad(reduced.usable, padding))
    return Page(reduce_image(page.texture), reduce_mask(page.hole), ~reduce_mask(~page.usable))


def _stack(pages: list[Page], window: tuple[int, int], wrap: tuple[bool, bool]) -> Level:
    texture, hole, usable = (np.concatenate([getattr(page, name) for page in pages]) for name in ("texture", "hole", "usable"))
    inside = np.zeros(hole.shape, bool)
    inside[: window[0], : window[1]] = True
    hole &= inside
    valid = minimum_filter(usable & ~hole, 2 * RADIUS + 1, mode="constant")
    return Level(
        shape=hole.shape,
        window=window,
        wrap=wrap,
        texture=texture.reshape(-1, texture.shape[2]),
        hole=hole.ravel(),
        filled=(inside & ~hole).ravel(),
        valid=valid.ravel(),
        source=np.full(hole.size, -1, np.int64),
    )
