"""The coarsest coverings, for any number of quads from six on: slabs along the axes, each with the faces that are turned most to it."""

import numpy as np

from ..primitives import Primitives
from .patches import Covering, Patch, group_by_label
from .rectangles import fit_rectangle

AXES = np.concatenate([np.eye(3), -np.eye(3)])
MIN_SLABS = len(AXES)
MARGIN = 1e-3  # Added to the error, for rounding.


def cover_with_slabs(primitives: Primitives, longest_side: float, count: int) -> tuple[Covering, float]:
    """Cover `primitives` with at most `count` quads, six or more: the thickest slab is split in halves until there are so many.

    Returns:
        The covering and its error over `longest_side`, at most about one half.
    """
    sides = (primitives.normals @ AXES.T).argmax(axis=1)
    slabs = [(axis, members) for axis, members in zip(AXES, group_by_label(sides, len(AXES)), strict=True) if len(members)]
    bounds = [_height_range(primitives, *slab) for slab in slabs]
    while len(slabs) < count:
        thickest = int(np.argmax([high - low for low, high in bounds]))
        halves = _split(primitives, *slabs[thickest])
        if not halves:
            break
        slabs[thickest : thickest + 1] = halves
        bounds[thickest : thickest + 1] = [_height_range(primitives, *slab) for slab in halves]
    owner = np.empty(len(primitives), np.int32)
    patches = []
    for index, ((normal, members), (low, high)) in enumerate(zip(slabs, bounds, strict=True)):
        owner[members] = index
        first = np.roll(np.abs(normal), 1)
        axes, rectangle = fit_rectangle(primitives.points[primitives.find_points(members)], np.array([first, np.cross(normal, first)]))
        patches.append(Patch(normal, 0.5 * (low + high), axes, rectangle, members, members))
    error = max(0.5 * (high - low) for low, high in bounds)
    return Covering(patches, owner), (1.0 + MARGIN) * max(error / longest_side, MARGIN)


def _height_range(primitives: Primitives, normal: np.ndarray, members: np.ndarray) -> tuple[float, float]:
    """Return the lowest and the highest corner of `members` along `normal`."""
    heights = primitives.positions[members] @ normal
    return float(heights.min()), float(heights.max())


def _split(primitives: Primitives, normal: np.ndarray, members: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the two slabs of the `members` below and above the middle of their centers; nothing if these have one height."""
    heights = primitives.positions[members].mean(axis=1) @ normal
    is_low = heights < 0.5 * (heights.min() + heights.max())
    return [(normal, members[is_low]), (normal, members[~is_low])] if is_low.any() else []
