"""Texture in the holes of windows: by regions, by pixels, or by pixels where no region reaches."""

from dataclasses import replace

import numpy as np

from ..jobs.progress import Steps, subprogress
from .levels import Level, Page, build_levels
from .regions import copy_regions
from .seams import blend_seams
from .settings import RestoreSettings
from .synthesis import synthesize


def fill_texture(pages: list[Page], levels: list[Level], settings: RestoreSettings) -> Steps[None]:
    """Fill the holes of the finest of `levels`, built from `pages`, in place. Coarser levels may change, too."""
    level = levels[0]
    total, remaining = np.count_nonzero(level.hole), level.hole
    if settings.method == "regions":
        yield from subprogress(copy_regions(level, settings.seed), 0.0, 0.9)
        remaining = level.hole & ~level.filled
        if remaining.any():
            levels = build_levels([_update(page, level, index) for index, page in enumerate(pages)], settings.pyramid_levels)
    if remaining.any():
        yield from subprogress(synthesize(levels, settings), 1.0 - np.count_nonzero(remaining) / total, 1.0)
        level.source[remaining], level.texture[remaining] = levels[0].source[remaining], levels[0].texture[remaining]
    blend_seams(level)


def _update(page: Page, level: Level, index: int) -> Page:
    """Return a page of `level` in whose hole only the pixels are left that no region fills."""
    pixels = level.pixels(index)
    filled = level.filled[pixels].reshape(page.hole.shape)
    return replace(page, texture=level.page(index).copy(), hole=page.hole & ~filled, known=page.known | (page.hole & filled))
