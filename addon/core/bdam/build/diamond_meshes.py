"""Meshes of whole diamonds, before they are simplified: from the field for the finest diamonds, from finer patches for the others."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from ..simplification.collapse_costs import ANTIDIAGONAL, DIAGONAL, FREE, HORIZONTAL, LOCKED, VERTICAL
from ..tree import Tree
from .height_grid import HeightGrid
from .patch_set import PatchSet


@dataclass(frozen=True)
class DiamondMeshes:
    """The meshes of D diamonds without common vertices. Vertices are in ascending order of their diamonds, then x, then y.

    domains: (V,) int32, diamond of each vertex. x, y, z: (V,) int32. slopes: (V, 2) float32, known on the outer boundary of each diamond, NaN
    elsewhere. triangles: (T, 3) int32. samples: (S, 3) int32, samples (x, y, z) that are not vertices, but whose distances count.
    sample_triangles: (S,) int32, the triangles that contain them.
    """

    domains: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    slopes: np.ndarray
    triangles: np.ndarray
    samples: np.ndarray
    sample_triangles: np.ndarray


def triangulate_field(tree: Tree, centers: np.ndarray, grid: HeightGrid) -> DiamondMeshes:
    """Triangulate the finest diamonds, one level above the leaves, with all of their samples.

    Args:
        centers: (D, 2) int64, midpoints of their hypotenuses in grid coordinates.
    """
    offsets, template = diamond_template(tree.leaf_cells)
    x, y = (centers[:, None] + offsets).transpose(2, 0, 1)
    is_inside = (x >= 0) & (y >= 0) & (x < tree.columns) & (y < tree.rows)
    in_field = is_inside[:, template].all(axis=2)
    numbers = np.cumsum(is_inside.ravel(), dtype=np.int32).reshape(is_inside.shape) - 1
    triangles = numbers[:, template][in_field]
    x, y = x[is_inside].astype(np.int32), y[is_inside].astype(np.int32)
    domains = np.broadcast_to(np.arange(len(centers), dtype=np.int32)[:, None], is_inside.shape)[is_inside]
    is_boundary = np.broadcast_to(np.abs(offsets).sum(axis=1) == tree.leaf_cells, is_inside.shape)[is_inside]
    slopes = np.full((len(x), 2), np.nan, np.float32)
    slopes[is_boundary] = sample_slopes(x[is_boundary], y[is_boundary], grid)
    no_samples = np.zeros((0, 3), np.int32), np.zeros(0, np.int32)
    return _remove_unused(DiamondMeshes(domains, x, y, grid.read_points(x, y), slopes, triangles, *no_samples))


@cache
def diamond_template(leaf_cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (V, 2) int32, relative to the center, and the counterclockwise triangles (T, 3) int32 of the samples within
    `leaf_cells` steps of the center.

    The diagonals of the cells alternate: they meet at samples with an even sum of coordinates, as the hypotenuses of the bintree do.
    """
    side = 2 * leaf_cells + 1
    x, y = np.mgrid[-leaf_cells : leaf_cells + 1, -leaf_cells : leaf_cells + 1].astype(np.int32)
    number = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    is_even = ((x + y)[:-1, :-1] % 2 == 0)[..., None]
    first = np.where(is_even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(is_even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    triangles = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    is_inside = (np.abs(x) + np.abs(y) <= leaf_cells).ravel()
    triangles = triangles[is_inside[triangles].all(axis=1)]
    renumbering = np.cumsum(is_inside, dtype=np.int32) - 1
    return np.stack([x.ravel(), y.ravel()], axis=1)[is_inside], renumbering[triangles]


def weld_patches(tree: Tree, patches: PatchSet, domains: np.ndarray) -> DiamondMeshes:
    """Weld the patches of diamonds along their common edges.

    Args:
        patches: of the next finer level. domains: (P,) int, the diamond of each patch.
    """
    vertex_counts = np.diff(patches.vertex_starts)
    of_vertex = np.repeat(domains.astype(np.int64), vertex_counts)
    size = tree.side + 1
    keys = (of_vertex * size + patches.x) * size + patches.y
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    numbers = patches.triangles + np.repeat(patches.vertex_starts[:-1], np.diff(patches.triangle_starts))[:, None]
    of_sample = np.repeat(patches.triangle_starts[:-1], np.diff(patches.sample_starts))
    return DiamondMeshes(
        of_vertex[first].astype(np.int32),
        patches.x[first],
        patches.y[first],
        patches.z[first],
        patches.slopes[first],
        inverse.reshape(-1).astype(np.int32)[numbers],
        patches.samples,
        (patches.sample_triangles + of_sample).astype(np.int32),
    )


def classify_vertices(tree: Tree, meshes: DiamondMeshes, corners: np.ndarray) -> np.ndarray:
    """Return what the vertices of diamonds may move along, (V,) int8 constants of `collapse_costs`.

    The outer boundary of a diamond is locked. The vertices of its hypotenuse and of the border of the field stay on these lines.

    Args:
        corners: (D, 2, 3, 2) int64, corners of the triangles of each diamond; the second triangle of single ones repeats the first.
    """
    x, y = meshes.x.astype(np.int64), meshes.y.astype(np.int64)
    lines = np.full(len(x), FREE, np.int8)
    start, end = (corners[meshes.domains, 0, end] for end in (0, 1))
    direction = end - start
    on_hypotenuse = direction[:, 0] * (y - start[:, 1]) == direction[:, 1] * (x - start[:, 0])
    along = np.where(
        direction[:, 1] == 0,
        HORIZONTAL,
        np.where(direction[:, 0] == 0, VERTICAL, np.where(direction[:, 0] == direction[:, 1], DIAGONAL, ANTIDIAGONAL)),
    )
    lines[on_hypotenuse] = along[on_hypotenuse]
    for is_on_border, line in ((_is_inner_border(x, tree.columns, tree), VERTICAL), (_is_inner_border(y, tree.rows, tree), HORIZONTAL)):
        lines = np.where(is_on_border, np.where((lines == FREE) | (lines == line), line, LOCKED), lines).astype(np.int8)
    for triangle in range(2):
        for leg in (1, 2):
            start = corners[meshes.domains, triangle, leg]
            direction = corners[meshes.domains, triangle, (leg + 1) % 3] - start
            lines[direction[:, 0] * (y - start[:, 1]) == direction[:, 1] * (x - start[:, 0])] = LOCKED
    return lines


def _is_inner_border(positions: np.ndarray, count: int, tree: Tree) -> np.ndarray:
    """Return whether coordinates are on the last row or column of the field, inside of the root square."""
    return (positions == count - 1) & (count - 1 < tree.side)


def sample_slopes(x: np.ndarray, y: np.ndarray, grid: HeightGrid) -> np.ndarray:
    """Return the derivatives (N, 2) float32 of the field at samples (N,), by central differences, in steps per cell."""
    slopes = np.empty((len(x), 2), np.float32)
    for axis, (dx, dy, count) in enumerate(((1, 0, grid.columns), (0, 1, grid.rows))):
        position = (x, y)[axis]
        span = np.minimum(position + 1, count - 1) - np.maximum(position - 1, 0)
        slopes[:, axis] = (grid.read_points(x + dx, y + dy) - grid.read_points(x - dx, y - dy)) / span
    return slopes


def _remove_unused(meshes: DiamondMeshes) -> DiamondMeshes:
    """Return the meshes without the vertices that no triangle uses."""
    is_used = np.zeros(len(meshes.x), bool)
    is_used[meshes.triangles] = True
    if is_used.all():
        return meshes
    renumbering = np.cumsum(is_used, dtype=np.int32) - 1
    arrays = (array[is_used] for array in (meshes.domains, meshes.x, meshes.y, meshes.z, meshes.slopes))
    return DiamondMeshes(*arrays, renumbering[meshes.triangles], meshes.samples, meshes.sample_triangles)
