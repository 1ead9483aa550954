"""Smooth interpolation of missing pixels: the Laplace equation on the pixel grid, with barriers.

Isotropic diffusion (Oliveira et al., "Fast Digital Image Inpainting", 2001) run to convergence: every missing pixel becomes the mean of
those of its four neighbors that it is connected to.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from .grid_solver import solve_linked


def diffuse(
    image: np.ndarray, mask: np.ndarray, barriers: np.ndarray | None = None, wrap: tuple[bool, bool] = (False, False)
) -> np.ndarray:
    """Return `image` (H, W, C) float32 with the pixels in `mask` (H, W) bool interpolated smoothly from the others.

    barriers: (H, W) bool, pixels that separate the regions on both sides: values do not diffuse across them. Missing pixels of a barrier
    are interpolated last. A region without any known pixel at its boundary ignores barriers. wrap: whether opposite borders are neighbors,
    along rows and columns.

    Nothing is interpolated if every pixel is in the mask.
    """
    if not mask.any() or mask.all():
        return image.copy()
    result = image.copy()
    if barriers is None or not (barriers & mask).any():
        _fill(result, mask, None, wrap)
        return result
    open_mask = mask & ~barriers
    isolated = _isolated(open_mask, ~mask & ~barriers, wrap)
    _fill(result, open_mask & ~isolated, barriers | isolated, wrap)
    _fill(result, (mask & barriers) | isolated, None, wrap)
    return result


def _fill(result: np.ndarray, mask: np.ndarray, barriers: np.ndarray | None, wrap: tuple[bool, bool]) -> None:
    """Interpolate the pixels of `result` in `mask` in place; barrier pixels count as missing borders of the image."""
    if not mask.any():
        return
    unknowns = np.flatnonzero(mask)
    numbers = np.full(mask.size, -1, np.int64)
    numbers[unknowns] = np.arange(len(unknowns))
    values = result.reshape(mask.size, -1)
    diagonal, right_side = np.zeros(len(unknowns)), np.zeros((len(unknowns), values.shape[1]))
    rows, columns = [], []
    for neighbors, exists in _neighbors(unknowns, mask.shape, wrap):
        linked = exists if barriers is None else exists & ~barriers.ravel()[neighbors]
        diagonal += linked
        is_unknown = linked & (numbers[neighbors] >= 0)
        is_known = linked & ~is_unknown
        right_side[is_known] += values[neighbors[is_known]]
        rows.append(np.flatnonzero(is_unknown))
        columns.append(numbers[neighbors[is_unknown]])

    def nearest_values() -> np.ndarray:
        nearest = distance_transform_edt(mask, return_distances=False, return_indices=True)
        return result[tuple(nearest[:, mask])]

    links, positions = (np.concatenate(rows), np.concatenate(columns)), np.stack(np.divmod(unknowns, mask.shape[1]), axis=1)
    values[unknowns] = solve_linked(diagonal, links, positions, right_side, nearest_values)


def _neighbors(pixels: np.ndarray, shape: tuple[int, int], wrap: tuple[bool, bool]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield for each of the four directions the flat indices of the neighbors of `pixels`, and which of them exist."""
    y, x = np.divmod(pixels, shape[1])
    for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        exists = np.ones(len(pixels), bool)
        moved = []
        for position, step, size, wraps in ((y, dy, shape[0], wrap[0]), (x, dx, shape[1], wrap[1])):
            target = position + step
            if wraps:
                target = target % size
            else:
                exists &= (target >= 0) & (target < size)
                target = np.clip(target, 0, size - 1)
            moved.append(target)
        yield moved[0] * shape[1] + moved[1], exists


def _isolated(open_mask: np.ndarray, known: np.ndarray, wrap: tuple[bool, bool]) -> np.ndarray:
    """Return the pixels (H, W) bool of the connected regions of `open_mask` that no pixel of `known` adjoins.

    Regions that touch across a wrapped border are told apart; each is then filled from the other.
    """
    regions, count = label(open_mask)
    has_known = np.zeros(count + 1, bool)
    pixels = np.flatnonzero(open_mask)
    numbers = regions.ravel()[pixels]
    for neighbors, exists in _neighbors(pixels, known.shape, wrap):
        has_known[numbers[exists & known.ravel()[neighbors]]] = True
    return open_mask & ~has_known[regions]
