"""Blending of the seams between copied regions, in the gradient domain (Perez et al., "Poisson Image Editing", 2003).

The texture that is nearest, in the sense of least squares, to the differences between neighboring pixels in the source of each copy, and
to a small degree to the copies themselves. Regions that fit keep their texture; where two do not, or a region meets the boundary of the
hole, the step between them is spread over a few pixels.
"""

import numpy as np

from ..imaging.grid_solver import solve_linked
from .levels import Level

FIDELITY = 0.01  # weight of the copies relative to that of the differences: steps are spread over about ten pixels
BOUNDARY_WEIGHT = 3.0  # of differences across the boundary of the hole
STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])


def blend_seams(level: Level) -> None:
    """Blend the seams in the hole of a synthesized `level`, in place."""
    pixels, texture = np.flatnonzero(level.hole), level.texture
    numbers = np.full(level.hole.size, -1, np.int64)
    numbers[pixels] = np.arange(len(pixels))
    diagonal = np.full(len(pixels), FIDELITY)
    right_side = FIDELITY * texture[pixels].astype(np.float64)
    rows, columns = [], []
    for step in STEPS:
        neighbors, exists = (array[:, 0] for array in level.neighbors(pixels, step[None]))
        offset, is_copy = level.offset(step), level.hole[neighbors]
        own = level.source[pixels]
        theirs = np.where(is_copy, level.source[neighbors], own + offset)
        difference = 0.5 * (texture[own] - texture[own + offset] + texture[theirs - offset] - texture[theirs])
        inner = exists & is_copy
        border = exists & ~is_copy
        weight = inner + BOUNDARY_WEIGHT * border
        diagonal += weight
        right_side += weight[:, None] * difference
        right_side[border] += BOUNDARY_WEIGHT * texture[neighbors[border]]
        rows.append(np.flatnonzero(inner))
        columns.append(numbers[neighbors[inner]])
    links, positions = (np.concatenate(rows), np.concatenate(columns)), np.stack(np.divmod(pixels, level.shape[1]), axis=1)
    texture[pixels] = solve_linked(diagonal, links, positions, right_side, lambda: texture[pixels])
