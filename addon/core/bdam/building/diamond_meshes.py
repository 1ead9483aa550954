"""Meshes of whole diamonds, before they are simplified: from the field for the finest diamonds, from finer patches for the others."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from ..height_meshes import find_used, triangulate_cells
from ..simplification.collapse_costs import ANTIDIAGONAL, DIAGONAL, FREE, HORIZONTAL, LOCKED, VERTICAL
from ..tree import Tree
from .height_grid import HeightGrid
from .patch_set import PatchSet


@dataclass(frozen=True)
class DiamondMeshes:
    """The meshes of D diamonds without common vertices. Vertices are in ascending order of their diamonds, then x, then y.

    Attributes:
        domains: (V,) int32, diamond of each vertex.
        x, y, z: (V,) int32, grid coordinates and heights in steps.
        gradients: (V, 2) float32, steps per cell, known on the outer boundary of each diamond, NaN elsewhere.
        triangles: (T, 3) int32, counterclockwise.
        samples: (S, 3) int32, samples (x, y, z) that are not vertices, but whose distances count.
        sample_triangles: (S,) int32, the triangles that contain them.
    """

    domains: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    gradients: np.ndarray
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
    numbers = np.cumsum(is_inside.ravel(), dtype=np.int32).reshape(is_inside.shape) - np.int32(1)
    triangles = numbers.take(template, axis=1)
    triangles = triangles.reshape(-1, 3) if is_inside.all() else triangles[is_inside.take(template, axis=1).all(axis=2)]
    x, y = x[is_inside].astype(np.int32), y[is_inside].astype(np.int32)
    domains = np.broadcast_to(np.arange(len(centers), dtype=np.int32)[:, None], is_inside.shape)[is_inside]
    is_boundary = np.broadcast_to(np.abs(offsets).sum(axis=1) == tree.leaf_cells, is_inside.shape)[is_inside]
    gradients = np.full((len(x), 2), np.nan, np.float32)
    gradients[is_boundary] = sample_gradients(x[is_boundary], y[is_boundary], grid)
    no_samples = np.zeros((0, 3), np.int32), np.zeros(0, np.int32)
    return _remove_unused(DiamondMeshes(domains, x, y, grid.read_points(x, y), gradients, triangles, *no_samples))


@cache
def diamond_template(leaf_cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (V, 2) int32, relative to the center, and the counterclockwise triangles (T, 3) int32 of the samples within
    `leaf_cells` steps of the center."""
    vertices = np.mgrid[-leaf_cells : leaf_cells + 1, -leaf_cells : leaf_cells + 1].astype(np.int32).reshape(2, -1).T
    triangles = triangulate_cells(2 * leaf_cells)
    is_inside = np.abs(vertices).sum(axis=1) <= leaf_cells
    is_used, triangles = find_used(triangles[is_inside[triangles].all(axis=1)], len(vertices))
    return np.ascontiguousarray(vertices[is_used]), triangles


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
        patches.gradients[first],
        inverse.reshape(-1).astype(np.int32)[numbers],
        patches.samples,
        (patches.sample_triangles + of_sample).astype(np.int32),
    )


def classify_vertices(tree: Tree, meshes: DiamondMeshes, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find what the vertices of diamonds of one level may move along.

    The outer boundary of a diamond is locked. The vertices of its hypotenuse and of the border of the field stay on these lines.

    Args:
        corners: (D, 3, 2) int64, corners of the first triangle of each diamond.

    Returns:
        Constants of `collapse_costs`, (V,) int8, and on which side of the hypotenuse vertices are, (V,) int32: positive on that of the
        first triangle, 0 on the hypotenuse.
    """
    center_x, center_y = ((corners[:, 0] + corners[:, 1]) // 2).T.astype(np.int32)
    direction = corners[:, 1] - corners[:, 0]
    sign_x, sign_y = np.sign(direction).T.astype(np.int32)
    x, y = meshes.x - center_x.take(meshes.domains), meshes.y - center_y.take(meshes.domains)
    sides = y * sign_x.take(meshes.domains) - x * sign_y.take(meshes.domains)
    along = np.choose(sign_x * sign_y + 1, (ANTIDIAGONAL, np.where(sign_y == 0, HORIZONTAL, VERTICAL), DIAGONAL)).astype(np.int8)
    lines = np.where(sides == 0, along.take(meshes.domains), np.int8(FREE))
    for is_on_border, line in (
        (_is_inner_border(meshes.x, tree.columns, tree), VERTICAL),
        (_is_inner_border(meshes.y, tree.rows, tree), HORIZONTAL),
    ):
        lines[is_on_border] = np.where((lines[is_on_border] == FREE) | (lines[is_on_border] == line), line, LOCKED)
    # The triangles of a level have the same size, and diamonds are squares: axis-parallel ones with diagonal hypotenuses, or rotated ones.
    half = np.abs(direction[0]).max() // 2
    x, y = np.abs(x), np.abs(y)
    distances = x + y if direction[0].min() == 0 or direction[0].max() == 0 else np.maximum(x, y)
    lines[distances == half] = LOCKED
    return lines, sides


def _is_inner_border(positions: np.ndarray, count: int, tree: Tree) -> np.ndarray:
    """Return whether coordinates are on the last row or column of the field, inside of the root square."""
    return (positions == count - 1) & (count - 1 < tree.side)


def sample_gradients(x: np.ndarray, y: np.ndarray, grid: HeightGrid) -> np.ndarray:
    """Return the derivatives (N, 2) float32 of the field at samples (N,), by central differences, in steps per cell."""
    gradients = np.empty((len(x), 2), np.float32)
    heights = grid.read_points(np.concatenate([x + 1, x - 1, x, x]), np.concatenate([y, y, y + 1, y - 1])).reshape(4, -1)
    for axis, (position, count) in enumerate(((x, grid.columns), (y, grid.rows))):
        span = np.minimum(position + 1, count - 1) - np.maximum(position - 1, 0)
        gradients[:, axis] = (heights[2 * axis] - heights[2 * axis + 1]) / span
    return gradients


def _remove_unused(meshes: DiamondMeshes) -> DiamondMeshes:
    """Return the meshes without the vertices that no triangle uses."""
    is_used, triangles = find_used(meshes.triangles, len(meshes.x))
    if triangles is meshes.triangles:
        return meshes
    arrays = (array[is_used] for array in (meshes.domains, meshes.x, meshes.y, meshes.z, meshes.gradients))
    return DiamondMeshes(*arrays, triangles, meshes.samples, meshes.sample_triangles)
