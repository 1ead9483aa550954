"""The patches of all levels in one sequence, and how they belong together.

The number of a patch is that of its block in the geometry file: those of level 0 come first, then those of level 1, and so on.
"""

from dataclasses import dataclass, replace

import numpy as np

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

    def locate(self, patch: int) -> tuple[int, int]:
        """Return the level of a patch and its row in this level."""
        level = int(np.searchsorted(self.starts, patch, side="right")) - 1
        return level, patch - int(self.starts[level])

    def find_grandchildren(self, patches: np.ndarray) -> np.ndarray:
        """Return the grandchildren (4, N) int of `patches` (N,): where there are fewer, others twice, or children, or the patches."""
        for _ in range(2):
            children = self.children.take(patches, axis=0).reshape(-1, 2).T
            is_missing = children == NO_PATCH
            if is_missing.any():
                children = np.where(is_missing, children[::-1], children)
                children = np.where(children == NO_PATCH, patches.reshape(-1), children)
            patches = children
        return patches.reshape(4, -1)


def link_patches(levels: list[Level]) -> PatchLinks:
    """Return the relatives of the patches of all levels.

    The neighbors of a triangle follow from those of its parent. The hypotenuse of a child is a leg of the parent; triangles that share a
    leg have the same right angle, so that it is the first leg of one of them and the second leg of the other.
    """
    starts = np.concatenate([[0], np.cumsum([len(level.indices) for level in levels])])
    parents = np.full(starts[-1], NO_PATCH, np.int32)
    children = np.full((starts[-1], 2), NO_PATCH, np.int32)
    partners = np.arange(starts[-1], dtype=np.int32)
    partners[:2] = hypotenuse = np.array([1, 0], np.int32)  # the field is on both sides of the diagonal of the root square
    first_leg = second_leg = np.full(2, NO_PATCH, np.int32)
    for number in range(1, len(levels)):
        start, stop = (int(position) for position in starts[number : number + 2])
        rows = np.searchsorted(levels[number - 1].indices, levels[number].indices >> 1).astype(np.int32)
        sides = (levels[number].indices & 1).astype(np.int8)
        parents[start:stop] = rows + np.int32(starts[number - 1])
        children[parents[start:stop], sides] = np.arange(start, stop, dtype=np.int32)
        is_second = sides == 1
        sibling = children[parents[start:stop], 1 - sides]
        across = _find_child(children, hypotenuse[rows], 1 - sides)  # the middle of the hypotenuse of the parent
        hypotenuse = _find_child(children, np.where(is_second, first_leg[rows], second_leg[rows]), 1 - sides)
        first_leg, second_leg = np.where(is_second, sibling, across), np.where(is_second, across, sibling)
        has_partner = hypotenuse != NO_PATCH
        partners[start:stop][has_partner] = hypotenuse[has_partner]
    return PatchLinks(starts, parents, children, partners)


def _find_child(children: np.ndarray, patches: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return the children (N,) on `sides` (N,), 0 or 1, of patches (N,) that may be NO_PATCH."""
    return np.where(patches == NO_PATCH, np.int32(NO_PATCH), children[patches, sides])


def join_bounds(levels: list[Level]) -> tuple[np.ndarray, list[Level]]:
    """Return what decides about cuts in one array, and the same levels as views of it.

    Returns:
        (N, 7) float32, for each patch by number: low and high corner of the bounding box, and the error, all in meters.
    """
    bounds = np.empty((sum(len(level.indices) for level in levels), 7), np.float32)
    views, start = [], 0
    for level in levels:
        part = bounds[start : start + len(level.indices)]
        part[:, :3], part[:, 3:6], part[:, 6] = level.low, level.high, level.errors
        views.append(replace(level, low=part[:, :3], high=part[:, 3:6], errors=part[:, 6]))
        start += len(part)
    return bounds, views
