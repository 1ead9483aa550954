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
    rows, columns = np.concatenate(rows), np.concatenate(columns)
    size = len(pixels)
    weights = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size)).tocsr()
    matrix = csr_matrix((diagonal, (np.arange(size), np.arange(size))), shape=(size, size)) - weights
    if size <= MAX_DIRECT_UNKNOWNS:
        solution = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(right_side)
    else:
        solution = solve_grid(matrix, np.stack(np.divmod(pixels, level.shape[1]), axis=1), right_side, texture[pixels])
    texture[pixels] = solution
