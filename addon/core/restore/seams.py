"""Blending of the seams between copied regions, in the gradient domain (Perez et al., "Poisson Image Editing", 2003).

The texture that is nearest, in the sense of least squares, to the differences between neighboring pixels in the source of each copy, and
to a small degree to the copies themselves. Regions that fit keep their texture; where two do not, or a region meets the boundary of the
hole, the step between them is spread over a few pixels.
"""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

from ..imaging.grid_solver import MAX_DIRECT_UNKNOWNS, solve_grid
from .levels import Level

FIDELITY = 0.02  # weight of the copies relative to that of the differences: steps are spread over about seven pixels
STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])


def blend_seams(level: Level) -> None:
    """Blend the seams in the hole of a synthesized `level`, in place."""
    pixels = np.flatnonzero(level.hole)
    numbers = np.full(level.hole.size, -1, np.int64)
    numbers[pixels] = np.arange(len(pixels))
    diagonal = np.full(len(pixels), FIDELITY)
    right_side = FIDELITY * level.texture[pixels].astype(np.float64)
    rows, columns = [], []
    for step in STEPS:
        neighbors, exists = (array[:, 0] for array in level.neighbors(pixels, step[None]))
        own = level.texture[level.source[pixels]] - level.texture[level.source[pixels] + level.offset(step)]
        is_copy = level.hole[neighbors]
        sources = np.where(is_copy, level.source[neighbors], level.source[pixels])
        theirs = level.texture[np.where(is_copy, sources - level.offset(step), sources)] - level.texture[np.where(is_copy, sources, sources + level.offset(step))]
        difference = 0.5 * (own + theirs)
        diagonal += exists
        right_side += np.where(exists[:, None], difference, 0.0)
        inner = exists & is_copy
        border = exists & ~is_copy
        right_side[border] += level.texture[neighbors[border]]
        rows.append(np.flatnonzero(inner))
        columns.append(numbers[neighbors[inner]])
    rows, columns = np.concatenate(rows), np.concatenate(columns)
    size = len(pixels)
    weights = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size)).tocsr()
    matrix = csr_matrix((diagonal, (np.arange(size), np.arange(size))), shape=(size, size)) - weights
    if size <= MAX_DIRECT_UNKNOWNS:
        solution = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(right_side)
    else:
        solution = solve_grid(matrix, np.stack(np.divmod(pixels, level.shape[1]), axis=1), right_side, level.texture[pixels])
    level.texture[pixels] = solution
