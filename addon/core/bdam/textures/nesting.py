"""Errors and bounding spheres of texture tiles, nested so that every cut is a quadtree whose neighbors differ by one level at most.

A cut refines a tile if its error, seen from the nearest point of its sphere, exceeds the tolerance: a test that can only become true when
the error grows or the sphere contains more. Let P be a refined tile of level t + 1, N a tile of that level that shares an edge with it, and
Q the parent of N. If error(Q) >= error(P) and sphere(Q) contains sphere(P), Q is refined, too. So every tile that shares an edge with a
refined tile is in the cut or refined, and no tile of the cut touches one that is two levels finer along an edge.

Hence the error of a tile is at least, and its sphere contains, those of its four children and of the eight tiles that share an edge with a
child. This holds for every viewer, tolerance and vertical scale, as long as all tiles are tested with the same of these, by `refine` or by
any other test that is monotone in the sense above.
"""

import numpy as np

from .grid import TextureGrid
from .tile_index import TileIndex

ROUNDING = 1e-6  # relative: radii are larger by this much, so that containment survives tests with float32


def nest_errors(index: TileIndex, own: np.ndarray) -> np.ndarray:
    """Return the errors (N,) of the tiles with the nesting of this module: the largest of the `own` (N,) errors that they depend on."""
    errors = own.copy()
    for level in range(index.level_count - 2, -1, -1):
        numbers, relatives = index.numbers(level), index.relatives(level)
        if relatives.size:
            below = np.where(relatives >= 0, errors[relatives], 0.0).max(axis=1)
            errors[numbers] = np.maximum(errors[numbers], below)
    return errors


def nest_spheres(index: TileIndex, grid: TextureGrid, heights: np.ndarray, corner: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return centers (N, 3) and radii (N,) float64, in meters, of the spheres that a cut must test; see this module.

    Without the eight neighbors of the children a sphere would have about 0.7 sides of its tile as its radius, with them about 1.6.

    Args:
        index: the tiles.
        grid: their layout.
        heights: (N, 2) float64, lowest and highest height of the surface in each tile, in meters, with the vertical scale that is shown.
        corner: local meters (x, y) of sample (0, 0).

    Returns:
        Spheres that contain the part of the surface in their tile, and the spheres of its relatives. They must be computed again when the
        vertical scale changes.
    """
    sides = (grid.size / (1 << index.levels.astype(np.int64)))[:, None] * np.asarray(grid.spacing)
    low, high = heights[:, 0], heights[:, 1]
    centers = np.column_stack([corner + (index.tiles + 0.5) * sides, 0.5 * (low + high)])
    radii = 0.5 * np.sqrt((sides**2).sum(axis=1) + (high - low) ** 2)
    for level in range(index.level_count - 2, -1, -1):
        numbers, relatives = index.numbers(level), index.relatives(level)
        if relatives.size:
            reach = np.linalg.norm(centers[relatives] - centers[numbers][:, None], axis=2) + radii[relatives]
            radii[numbers] = np.maximum(radii[numbers], np.where(relatives >= 0, reach, 0.0).max(axis=1) * (1.0 + ROUNDING))
    return centers, radii


def refine(
    errors: np.ndarray, centers: np.ndarray, radii: np.ndarray, eye: np.ndarray, pixels_per_radian: float, tolerance: float
) -> np.ndarray:
    """Return whether each tile must be refined, (N,) bool: its error, seen from the nearest point of its sphere, exceeds the tolerance.

    errors (N,), centers (N, 3), radii (N,) and eye (3,) are in meters, the tolerance in pixels.
    """
    distances = np.maximum(np.linalg.norm(centers - eye, axis=1) - radii, 0.0)
    return errors * pixels_per_radian > tolerance * distances


def balance(index: TileIndex, is_refined: np.ndarray) -> np.ndarray:
    """Return `is_refined` (N,) bool with the further tiles that must be refined so that neighbors differ by one level at most, and that
    every ancestor of a refined tile is refined.

    An alternative to nested errors and spheres, for one cut: any test of tiles becomes a valid cut. Of two cuts of which one refines all
    that the other one does, the same holds after this.
    """
    result = is_refined.copy()
    for level in range(index.level_count - 2, -1, -1):
        numbers, relatives = index.numbers(level), index.relatives(level)
        if relatives.size:
            result[numbers] |= (result[relatives] & (relatives >= 0)).any(axis=1)
    return result


def select_cut(index: TileIndex, is_refined: np.ndarray) -> np.ndarray:
    """Return the numbers of the tiles of the cut: those below refined ancestors that are not refined, or of the finest level.

    Where children of a refined tile do not exist, nothing is known, and the cut has no tile there.
    """
    parents = index.parents()
    is_open = np.zeros(len(index), bool)
    is_visited = parents < 0
    for level in range(index.level_count):
        numbers = index.numbers(level)
        if level:
            is_visited[numbers] = is_open[parents[numbers]] & (parents[numbers] >= 0)
        is_open[numbers] = is_visited[numbers] & is_refined[numbers] & (level < index.level_count - 1)
    return np.flatnonzero(is_visited & ~is_open)
