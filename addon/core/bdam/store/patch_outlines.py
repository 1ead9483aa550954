"""Outlines: patches without the vertices inside, for where nobody looks.

An outline has the boundary of its patch, so that it fits to the neighbors of the patch, and about a tenth of its triangles.
"""

import numpy as np

from .patch_codec import Patch


def count_outline_triangles(patch: Patch, corners: np.ndarray) -> int:
    """Return the number of triangles of the outline of a patch with `corners` (3, 2) in the bintree."""
    return len(patch.boundary) - 2 if _find_chains(patch, corners) is not None else len(patch.triangles)


def triangulate_outline(patch: Patch, corners: np.ndarray) -> np.ndarray | None:
    """Return the triangles (T, 3) int32 of an outline, of the vertices in `patch.boundary`, counterclockwise.

    None if the patch has no outline but itself: if it has holes, reaches beyond the field, or no vertex inside of its hypotenuse.

    The vertices of the hypotenuse and of the legs are two chains from its start to its end. Each triangle advances on one of them; the
    first and the last one on both, since a triangle of vertices on one edge has no area.
    """
    chains = _find_chains(patch, corners)
    if chains is None:
        return None
    hypotenuse, legs, along = chains
    places = np.concatenate([along[hypotenuse[2:-1]], along[legs[2:-1]]])
    is_on_hypotenuse = np.argsort(places, kind="stable") < len(hypotenuse) - 3
    below = 1 + np.cumsum(is_on_hypotenuse) - is_on_hypotenuse  # where the chains are before each step
    above = 1 + np.cumsum(~is_on_hypotenuse) - ~is_on_hypotenuse
    triangles = np.empty((len(places) + 2, 3), np.int32)
    triangles[0] = hypotenuse[0], hypotenuse[1], legs[1]
    triangles[1:-1, 0] = hypotenuse[below]
    triangles[1:-1, 1] = np.where(is_on_hypotenuse, hypotenuse[below + 1], legs[above + 1])
    triangles[1:-1, 2] = legs[above]
    triangles[-1] = hypotenuse[-2], hypotenuse[-1], legs[-2]
    return triangles


def _find_chains(patch: Patch, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the vertices (H,) of the hypotenuse and (L,) of the legs, both from the start to the end of the hypotenuse, by their places in
    the boundary, and how far along the hypotenuse they are, (B,) int64; None if there is no outline."""
    if patch.is_hole.any():
        return None
    start, end = corners[:2].astype(np.int64)
    x, y = patch.x[patch.boundary].astype(np.int64) - start[0], patch.y[patch.boundary].astype(np.int64) - start[1]
    direction = end - start
    along, height = x * direction[0] + y * direction[1], direction[0] * y - direction[1] * x
    order = np.lexsort((height, along))
    is_on_hypotenuse = height[order] == 0
    hypotenuse = order[is_on_hypotenuse]
    has_corners = [bool(((x == corner[0]) & (y == corner[1])).any()) for corner in (corners - start)]
    if len(hypotenuse) < 3 or not all(has_corners):
        return None
    return hypotenuse, np.concatenate([hypotenuse[:1], order[~is_on_hypotenuse], hypotenuse[-1:]]), along
