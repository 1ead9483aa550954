"""The first collapses of a regular grid. Samples with an odd sum of coordinates have four neighbors and share no triangle, so their costs
are found at once and any number of them can be removed in one step."""

import numpy as np

from ..simplification.collapse_costs import FREE, HORIZONTAL, LOCKED, VERTICAL
from .diamond_meshes import DiamondMeshes

FRACTION = 0.6  # of the vertices to be removed


def choose_grid_collapses(meshes: DiamondMeshes, lines: np.ndarray, excess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Choose the cheapest samples that have four neighbors.

    Args:
        meshes: all samples of diamonds. lines: (V,) int8, constraints. excess: (D,) int, how many vertices to remove from each diamond.

    Returns:
        Vertices (N,) int32 and the neighbors (N,) int32 to collapse them onto.
    """
    odd = np.flatnonzero(((meshes.x + meshes.y) % 2 == 1) & (lines != LOCKED)).astype(np.int32)
    x_low, x_high, y_low, y_high = _find_neighbors(meshes, odd)
    z = meshes.z.astype(np.float32)
    across = np.abs(z[odd] - 0.5 * (z[x_low] + z[x_high]))
    along = np.abs(z[odd] - 0.5 * (z[y_low] + z[y_high]))
    across[((lines[odd] != FREE) & (lines[odd] != HORIZONTAL)) | (x_low < 0) | (x_high < 0)] = np.inf
    along[((lines[odd] != FREE) & (lines[odd] != VERTICAL)) | (y_low < 0) | (y_high < 0)] = np.inf
    costs = np.minimum(across, along)
    # At a boundary, the target is the neighbor with which the counterclockwise fan of triangles begins.
    targets = np.where(across <= along, np.where(y_low < 0, x_high, x_low), np.where(x_high < 0, y_high, y_low))
    domains = meshes.domains[odd]
    order = np.lexsort((costs, domains))
    counts = np.bincount(domains, minlength=len(excess))
    ranks = np.arange(len(odd)) - np.repeat(np.cumsum(counts) - counts, counts)
    chosen = order[(ranks < FRACTION * excess[domains[order]]) & np.isfinite(costs[order])]
    chosen.sort()
    return odd[chosen], targets[chosen]


def _find_neighbors(meshes: DiamondMeshes, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the vertices (N,) int32 before and after `vertices` along x and along y, -1 where there is none."""
    x, y, domains = (array.astype(np.int64) for array in (meshes.x, meshes.y, meshes.domains))
    width, height = int(x.max()) + 3, int(y.max()) + 3
    keys = (domains * height + y + 1) * width + x + 1
    order = np.argsort(keys, kind="stable")
    found = []
    for offset in (-1, 1, -width, width):
        wanted = keys[vertices] + offset
        positions = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
        found.append(np.where(keys[order[positions]] == wanted, order[positions], -1).astype(np.int32))
    return tuple(found)
