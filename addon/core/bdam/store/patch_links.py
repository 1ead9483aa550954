"""The patches of all levels in one sequence, and how they belong together.

The number of a patch is that of its block in the geometry file: those of level 0 come first, then those of level 1, and so on.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..tree import Tree
from .structure import Level

NO_PATCH = -1


@dataclass(frozen=True)
class PatchLinks:
    """Relatives of patches, by number.

    starts: (L + 1,) int64, the number of the first patch of each level, and that of all patches. parents: (N,) int32; NO_PATCH at level 0.
    children: (N, 2) int32; NO_PATCH where there is none. partners: (N,) int32, the other patch of the diamond, or the patch itself where
    there is none.
    """

    starts: np.ndarray
    parents: np.ndarray
    children: np.ndarray
    partners: np.ndarray


def link_patches(tree: Tree, levels: list[Level]) -> PatchLinks:
    """Return the relatives of the patches of all levels."""
    starts = np.concatenate([[0], np.cumsum([len(level.indices) for level in levels])])
    parents = np.full(starts[-1], NO_PATCH, np.int32)
    children = np.full((starts[-1], 2), NO_PATCH, np.int32)
    partners = np.arange(starts[-1], dtype=np.int32)
    for number, level in enumerate(levels):
        start, stop = (int(position) for position in starts[number : number + 2])
        if number:
            above = starts[number - 1] + np.searchsorted(levels[number - 1].indices, level.indices >> 1)
            parents[start:stop] = above
            children[above, level.indices & 1] = np.arange(start, stop)
        diamonds = tree.find_diamonds(number, level.indices)
        first, second = start + diamonds[diamonds[:, 1] >= 0].T
        partners[first], partners[second] = second, first
    return PatchLinks(starts, parents, children, partners)


def join_bounds(levels: list[Level]) -> tuple[np.ndarray, list[Level]]:
    """Return what decides about cuts in one array, and the same levels as views of it.

    Returns:
        (N, 7) float32, for each patch by number: low and high corner of the bounding box, and the error, all in meters.
    """
    bounds = np.concatenate([np.concatenate([level.low, level.high, level.errors[:, None]], axis=1) for level in levels])
    parts = np.split(bounds, np.cumsum([len(level.indices) for level in levels])[:-1])
    views = [
        replace(level, low=part[:, :3], high=part[:, 3:6], errors=part[:, 6]) for level, part in zip(levels, parts, strict=True)
    ]
    return bounds, views
