"""Texture in the holes of windows: by regions, by pixels, or by pixels where no region reaches; and the seams between copied regions.

Seams are blended in the gradient domain (Perez et al., "Poisson Image Editing", 2003). The texture is the one that is nearest, in the sense
of least squares, to the differences between neighboring pixels in the source of each copy, and to a small degree to the copies themselves.
Regions that fit keep their texture; where two do not, or a region meets the boundary of the hole, the step between them is spread over a
few pixels.
"""

from dataclasses import replace

import numpy as np

from ..imaging.grid_solver import solve_linked
from ..jobs.progress import Steps, subprogress
from .guidance import Guide
from .levels import SIDES, Level, Page, build_levels
from .regions import copy_regions
from .settings import RestoreSettings
from .synthesis import synthesize

FIDELITY = 0.01  # weight of the copies relative to that of the differences: steps are spread over about ten pixels
BOUNDARY_WEIGHT = 3.0  # weight of differences across the boundary of the hole


def fill_texture(pages: list[Page], levels: list[Level], guide: Guide | None, settings: RestoreSettings) -> Steps[None]:
    """Fill the holes of the finest of `levels`, built from `pages`, in place. Coarser levels may change, too.

    guide: for regions.
    """
    level = levels[0]
    total, remaining = np.count_nonzero(level.hole), level.hole
    if settings.method == "regions":
        yield from subprogress(copy_regions(level, guide, settings.seed), 0.0, 0.9)
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


def blend_seams(level: Level) -> None:
    """Blend the seams in the hole of a synthesized `level`, in place."""
    pixels, texture = np.flatnonzero(level.hole), level.texture
    numbers = np.full(level.hole.size, -1, np.int64)
    numbers[pixels] = np.arange(len(pixels))
    diagonal = np.full(len(pixels), FIDELITY)
    right_side = FIDELITY * texture[pixels].astype(np.float64)
    rows, columns = [], []
    for step in SIDES:
        neighbors, exists = (array[:, 0] for array in level.neighbors(pixels, step[None]))
        offset, is_copy = level.offset(step), level.hole[neighbors]
        own = level.source[pixels]
        theirs = np.where(is_copy, level.source[neighbors], own + offset)
        difference = 0.5 * (texture[own] - texture[own + offset] + texture[theirs - offset] - texture[theirs])
        inner, border = exists & is_copy, exists & ~is_copy
        weight = inner + BOUNDARY_WEIGHT * border
        diagonal += weight
        right_side += weight[:, None] * difference
        right_side[border] += BOUNDARY_WEIGHT * texture[neighbors[border]]
        rows.append(np.flatnonzero(inner))
        columns.append(numbers[neighbors[inner]])
    links, positions = (np.concatenate(rows), np.concatenate(columns)), np.stack(np.divmod(pixels, level.shape[1]), axis=1)
    texture[pixels] = solve_linked(diagonal, links, positions, right_side, lambda: texture[pixels])
