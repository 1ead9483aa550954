"""The samples and triangles of leaf patches, which follow from the bintree alone."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..height_meshes import find_used, triangulate_cells
from ..tree import Tree


@dataclass(frozen=True)
class LeafGrid:
    """A leaf with all samples of the field in its triangle.

    x, y: (V,) int32, grid coordinates, sorted by x, then y. triangles: (T, 3) int32, counterclockwise.
    """

    x: np.ndarray
    y: np.ndarray
    triangles: np.ndarray


def leaf_grid(tree: Tree, corners: np.ndarray) -> LeafGrid:
    """Return the samples of a leaf with `corners` (3, 2) int."""
    low = corners.min(axis=0)
    template = _template(tree.leaf_cells, *(tuple(int(value) for value in corner - low) for corner in corners))
    x, y = (template.x + low[0]).astype(np.int32), (template.y + low[1]).astype(np.int32)
    is_inside = (x < tree.columns) & (y < tree.rows)
    if is_inside.all():
        return LeafGrid(x, y, template.triangles)
    is_used, triangles = find_used(template.triangles[is_inside[template.triangles].all(axis=1)], len(x))
    return LeafGrid(x[is_used], y[is_used], triangles)


@lru_cache(maxsize=8)  # the four orientations of leaves, for two sizes
def _template(cells: int, start: tuple[int, int], end: tuple[int, int], apex: tuple[int, int]) -> LeafGrid:
    """Return the samples of a leaf whose bounding box begins at (0, 0)."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(cells + 1), np.arange(cells + 1), indexing="ij"))
    is_inside = np.ones(len(x), bool)
    for (ax, ay), (bx, by) in ((start, end), (end, apex), (apex, start)):
        is_inside &= (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0
    triangles = triangulate_cells(cells)
    is_used, triangles = find_used(triangles[is_inside[triangles].all(axis=1)], len(x))
    return LeafGrid(x[is_used].astype(np.int32), y[is_used].astype(np.int32), triangles)
