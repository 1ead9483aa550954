"""The samples and triangles of leaf patches, which follow from the bintree alone."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

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
    triangles = template.triangles[is_inside[template.triangles].all(axis=1)]
    is_used = np.zeros(len(x), bool)
    is_used[triangles] = True
    return LeafGrid(x[is_used], y[is_used], (np.cumsum(is_used, dtype=np.int32) - 1)[triangles])


@lru_cache(maxsize=8)  # the four orientations of leaves, for two sizes
def _template(cells: int, start: tuple[int, int], end: tuple[int, int], apex: tuple[int, int]) -> LeafGrid:
    """Return the samples of a leaf whose bounding box begins at (0, 0). Diagonals alternate, see `build.diamond_meshes`."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(cells + 1), np.arange(cells + 1), indexing="ij"))
    is_inside = np.ones(len(x), bool)
    for (ax, ay), (bx, by) in ((start, end), (end, apex), (apex, start)):
        is_inside &= (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    is_even = np.add.outer(np.arange(cells), np.arange(cells))[..., None] % 2 == 0
    first = np.where(is_even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(is_even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    triangles = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    triangles = triangles[is_inside[triangles].all(axis=1)]
    renumbering = np.cumsum(is_inside, dtype=np.int32) - 1
    return LeafGrid(x[is_inside].astype(np.int32), y[is_inside].astype(np.int32), renumbering[triangles])
