"""Holes of a texture, interpolated over the surface so that they meet what is around them without a border.

Vertices that no photograph shows get the colors of their neighbors (Textures Revisited, section 4.1). Colors that are interpolated between
vertices miss what happens between them, so on a coarse mesh a hole differs from the texels around it. That difference is known at its
border. It is continued smoothly into the hole, as a membrane that is fixed at the border, and added (compare Perez et al., "Poisson Image
Editing", 2003). Texels of the same island are neighbors; at seams of the UV map the membrane is free.
"""

import numpy as np
from scipy.ndimage import binary_dilation, generate_binary_structure
from scipy.sparse import coo_matrix, csr_matrix

from ...geometry.edges import Edges
from ...imaging.grid_solver import solve_grid
from .texel_map import TexelMap

REACH = 256.0  # texels after which a difference has faded where nothing else limits it
TOLERANCE = 1e-3
FRACTIONS = (0.8, 0.6, 0.4, 0.2, 0.0)  # A vertex needs this fraction of neighbors with a color, one stage after the other.
STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))  # rows and columns to the neighbors of a texel


def interpolate_holes(texel_map: TexelMap, colors: np.ndarray, found: np.ndarray, corner_colors: np.ndarray) -> None:
    """Fill the covered texels of `colors` (N, 3) float32 that are not `found` (N,) bool.

    They get `corner_colors` (T, 3, 3) float32, interpolated over triangles, and what these lack at the borders of the holes.
    """
    holes = (texel_map.triangles >= 0) & ~found
    pages = holes.reshape(-1, texel_map.size, texel_map.size)
    is_border = found & binary_dilation(pages, generate_binary_structure(2, 1)[None]).ravel()
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


def _look_up(indices: np.ndarray, wanted: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the ascending `indices` (N,) contain those `wanted` (M,), and which of them they contain if they are `inside` (M,)."""
    places = np.minimum(np.searchsorted(indices, wanted), len(indices) - 1)
    return places, inside & (indices[places] == wanted)


def interpolate_colors(colors: np.ndarray, known: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """Return the colors (V, C) of all vertices that are connected to known ones, and which vertices have a color (V,) bool.

    colors: (V, C). known: (V,) bool. A vertex gets the mean of its neighbors as soon as enough of them have a color; all vertices of one
    sweep at once, so that their order does not matter.
    """
    colors, known = np.where(known[:, None], colors, 0.0), known.copy()
    first, second = np.concatenate([edges.ends, edges.ends[:, ::-1]]).T
    neighbors = np.bincount(first, minlength=len(colors))
    for fraction in FRACTIONS:
        while not known.all():
            has_color = known[second]
            counts = np.bincount(first[has_color], minlength=len(colors))
            ready = ~known & (counts > 0) & (counts >= fraction * neighbors)
            if not ready.any():
                break
            used = has_color & ready[first]
            for channel in range(colors.shape[1]):
                sums = np.bincount(first[used], colors[second[used], channel], len(colors))
                colors[ready, channel] = sums[ready] / counts[ready]
            known |= ready
    return colors, known
