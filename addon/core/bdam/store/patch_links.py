"""The patches of all levels in one sequence, and how they belong together.

The number of a patch is that of its block in the geometry file: those of level 0 come first, then those of level 1, and so on.

Cuts avoid damaged patches without cracks. A damaged patch that has children is refined wherever a cut reaches it. Instead of a damaged leaf
its parent is shown, together with the other patch of the parent's diamond. Patches stay that coarse around it as far as a cut without
cracks needs it.

Level s of a quadtree has squares (i, j), i along x and j along y, whose side is that of the root square divided by 2**s. A patch of level 2
s or 2 s + 1 lies within one square of level s, and a patch of level 2 s is one half of it.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..tree import Tree, bisect
from .structure import Level

NO_PATCH = -1


@dataclass(frozen=True)
class PatchLinks:
    """Relatives of patches, by number.

    Attributes:
        starts: (L + 1,) int64, the number of the first patch of each level, and that of all patches.
        parents: (N,) int32; NO_PATCH at level 0.
        children: (N, 2) int32; NO_PATCH where there is none.
        partners: (N,) int32, the other patch of the diamond, or the patch itself where there is none.
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
        across = _find_child(children, hypotenuse[rows], 1 - sides)  # beyond the center of the parent's hypotenuse
        hypotenuse = _find_child(children, np.where(is_second, first_leg[rows], second_leg[rows]), 1 - sides)
        first_leg, second_leg = np.where(is_second, sibling, across), np.where(is_second, across, sibling)
        has_partner = hypotenuse != NO_PATCH
        partners[start:stop][has_partner] = hypotenuse[has_partner]
    return PatchLinks(starts, parents, children, partners)


def _find_child(children: np.ndarray, patches: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return the children (N,) on `sides` (N,), 0 or 1, of patches (N,) that may be NO_PATCH."""
    return np.where(patches == NO_PATCH, np.int32(NO_PATCH), children[patches, sides])


def find_leaf_squares(tree: Tree, levels: list[Level]) -> list[np.ndarray]:
    """Return for each level the squares (N, 2) int32 of the quadtree's finest level that contain the centroids of its patches.

    The square of level s with the centroid follows from it: `squares >> (depth - s)`.
    """
    corners = tree.triangle_corners(0, levels[0].indices).astype(np.int32)  # half of the memory
    squares = [_find_squares(corners, tree.leaf_cells)]
    for coarser, level in pairwise(levels):
        parents = np.searchsorted(coarser.indices, level.indices >> 1)
        corners = bisect(corners[parents], (level.indices & 1).astype(bool))
        squares.append(_find_squares(corners, tree.leaf_cells))
    return squares


def _find_squares(corners: np.ndarray, leaf_cells: int) -> np.ndarray:
    """Return the squares (N, 2) of triangles with `corners` (N, 3, 2) in cells."""
    return (corners.sum(axis=1, dtype=corners.dtype) // (3 * leaf_cells)).astype(np.int32, copy=False)


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


@dataclass(frozen=True)
class PatchLimits:
    """Which patches a cut must refine, and which it cannot, by number.

    is_required: (N,) bool, damaged patches. is_blocked: (N,) bool, patches above leaves below which there is no consistent cut without
    damaged patches. If it is true of a patch, it is true of the other patch of its diamond and of its descendants above leaves.
    """

    is_required: np.ndarray
    is_blocked: np.ndarray


def find_limits(links: PatchLinks, is_damaged: np.ndarray) -> PatchLimits:
    """Return the limits of cuts for damaged patches, (N,) bool. Cuts then contain none but roots for which there is no replacement."""
    is_leaf = (links.children == NO_PATCH).all(axis=1)
    is_blocked = is_leaf.copy()
    while True:
        shown = np.flatnonzero(is_damaged & is_blocked & (links.parents != NO_PATCH))
        parents = links.parents[shown]
        added = parents[~is_blocked[parents]]
        if not len(added):
            return PatchLimits(is_damaged & ~is_blocked, is_blocked & ~is_leaf)
        is_blocked[added] = True
        _spread(links, is_blocked)


def _spread(links: PatchLinks, is_blocked: np.ndarray) -> None:
    """Block the other patches of diamonds, and children."""
    for level, (start, stop) in enumerate(zip(links.starts[:-1], links.starts[1:], strict=True)):
        part = slice(int(start), int(stop))
        if level:
            is_blocked[part] |= is_blocked[links.parents[part]]
        is_blocked[part] |= is_blocked[links.partners[part]]
