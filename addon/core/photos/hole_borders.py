"""Interpolated holes of a texture that meet their surroundings without a border.

Colors that are interpolated between vertices miss what happens between them, so on a coarse mesh a hole differs from the texels around it.
That difference is known at its border. It is continued smoothly into the hole, as a membrane that is fixed at the border, and added
(compare Perez et al., "Poisson Image Editing", 2003). Texels of the same island are neighbors; at seams of the UV map the membrane is free.
"""

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_matrix, csr_matrix

from ..imaging.grid_solver import solve_grid
from .texels import TexelMap

REACH = 256.0  # texels after which a difference has faded where nothing else limits it
TOLERANCE = 1e-3
STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))  # rows and columns to the neighbors of a texel


def interpolate_holes(texel_map: TexelMap, colors: np.ndarray, found: np.ndarray, corner_colors: np.ndarray) -> None:
    """Fill the covered texels of `colors` (N, 3) float32 that are not `found` (N,) bool.

    They get `corner_colors` (T, 3, 3) float32, interpolated over triangles, and what these lack at the borders of the holes.
    """
    holes = (texel_map.triangles >= 0) & ~found
    is_border = found & _dilate(holes, texel_map.size)
    borders, missing = np.flatnonzero(is_border), np.flatnonzero(holes)
    differences = np.zeros((len(borders), 3), np.float32)
    used = holes | is_border
    for tile in texel_map.tiles():
        part = tile.select(np.flatnonzero(used[tile.texels]))
        interpolated, is_hole = part.interpolate(corner_colors), holes[part.texels]
        colors[part.texels[is_hole]] = interpolated[is_hole]
        own = part.texels[~is_hole]
        differences[np.searchsorted(borders, own)] = colors[own] - interpolated[~is_hole]
    colors[missing] += continue_differences(missing, borders, differences, texel_map.size)


def continue_differences(holes: np.ndarray, borders: np.ndarray, differences: np.ndarray, size: int) -> np.ndarray:
    """Return the differences (H, C) float32 at the texels of holes.

    Args:
        holes: (H,) flat indices of texels, ascending, in an image of all pages. borders: (B,) those of the texels around them, ascending.
        differences: (B, C) at the borders.
        size: texels per side.
    """
    if not len(holes) or not len(borders):
        return np.zeros((len(holes), differences.shape[1]), np.float32)
    positions = np.stack(np.divmod(holes, size), axis=1)
    diagonal, right_side = np.full(len(holes), REACH**-2), np.zeros((len(holes), differences.shape[1]))
    links = []
    for step in STEPS:
        target = positions + step
        is_same_page = target[:, 0] // size == positions[:, 0] // size
        inside = is_same_page & (target[:, 1] >= 0) & (target[:, 1] < size)
        neighbors = target[:, 0] * size + target[:, 1]
        unknown, is_unknown = _look_up(holes, neighbors, inside)
        known, is_known = _look_up(borders, neighbors, inside)
        diagonal += is_unknown | is_known
        right_side[is_known] += differences[known[is_known]]
        links.append((np.flatnonzero(is_unknown), unknown[is_unknown]))
    first, second = (np.concatenate(ends) for ends in zip(*links, strict=True))
    shape = (len(holes), len(holes))
    weights = coo_matrix((np.ones(len(first)), (first, second)), shape=shape).tocsr()
    matrix = csr_matrix((diagonal, (np.arange(len(holes)),) * 2), shape=shape) - weights
    return solve_grid(matrix, positions, right_side, np.zeros_like(right_side), TOLERANCE).astype(np.float32)


def _dilate(mask: np.ndarray, size: int) -> np.ndarray:
    """Return a mask (N,) of texels with their neighbors in the same page."""
    pages = mask.reshape(-1, size, size)
    return np.stack([binary_dilation(page) for page in pages]).ravel()


def _look_up(indices: np.ndarray, wanted: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the ascending `indices` (N,) contain those `wanted` (M,), and which of them they contain if they are `inside` (M,)."""
    places = np.minimum(np.searchsorted(indices, wanted), len(indices) - 1)
    return places, inside & (indices[places] == wanted)
