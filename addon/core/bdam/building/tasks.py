"""The tasks of a build: one task simplifies some diamonds of a level, encodes leaves, or makes texture tiles.

`core.jobs.task_pool` calls them. An item is [level, shard], or ["texture", name, level, [[i, j], ...]] with tiles of textures or of normal
maps; the reply is null, the results are files in the work folder. A task whose shard exists is skipped.
"""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...arrays import to_starts
from ...files.sealed_files import write_sealed
from ..store.leaf_grids import leaf_grid
from ..store.patch_codec import Patch, find_boundaries
from ..store.patch_encoding import encode_patches
from ..store.patch_outlines import count_outline_triangles
from .diamond_meshes import sample_gradients
from .patch_set import EncodedPatches, PatchSet, join, read_patches, write_patches
from .simplified_diamonds import simplify_diamonds
from .texture_stage import TEXTURE_TASK, TextureTasks
from .vertical_errors import bound_curvature_errors
from .work_folder import LevelLayout, WorkFolder


def open_tasks(arguments: list[str]) -> Callable[[list], None]:
    """Return the function of the tasks. arguments: the path of the work folder."""
    folder = WorkFolder.load(Path(arguments[0]))
    patches, textures = BuildTasks(folder), TextureTasks(folder)

    def run(item: list) -> None:
        if item[0] == TEXTURE_TASK:
            textures.run(*item[1:])
        else:
            patches.run(*item)

    return run


class BuildTasks:
    """Runs tasks of a build."""

    def __init__(self, folder: WorkFolder) -> None:
        self._folder = folder
        self._tree = folder.tree
        self._layout = lru_cache(maxsize=3)(self._create_layout)

    def run(self, level: int, shard: int) -> None:
        """Write the files of a shard. They need not survive a failure of power: a build that resumes checks their seals."""
        if self._folder.blocks_path(level, shard).exists():
            return
        encoded = self._encode_leaves(shard) if level == self._tree.leaf_level else self._simplify(level, shard)
        write_sealed(self._folder.blocks_path(level, shard), encoded.to_bytes(), is_durable=False)

    def _create_layout(self, level: int) -> LevelLayout:
        return LevelLayout.create(self._tree, level, self._folder.parameters.diamonds_per_shard)

    def _encode_leaves(self, shard: int) -> EncodedPatches:
        layout, grid, level = self._layout(self._tree.leaf_level), self._folder.grid, self._tree.leaf_level
        indices = layout.indices[layout.shards == shard]
        corners = self._tree.triangle_corners(level, indices)
        leaves = [leaf_grid(self._tree, corner) for corner in corners]
        low, high = corners.min(axis=(0, 1)), np.minimum(corners.max(axis=(0, 1)), [self._tree.columns - 1, self._tree.rows - 1])
        heights, is_known = grid.read(slice(low[1], high[1] + 1), slice(low[0], high[0] + 1))
        x, y = (np.concatenate([getattr(leaf, axis) for leaf in leaves]) for axis in "xy")
        starts = to_starts(np.array([len(leaf.x) for leaf in leaves]))
        boundary, boundary_starts = find_boundaries(x, y, corners, np.diff(starts))
        gradients = np.split(sample_gradients(x[boundary], y[boundary], grid), boundary_starts[1:-1])
        boundaries = np.split((boundary - np.repeat(starts[:-1], np.diff(boundary_starts))).astype(np.int32), boundary_starts[1:-1])
        patches = []
        for leaf, rows_on_edge, gradient in zip(leaves, boundaries, gradients, strict=True):
            rows, columns = leaf.y - low[1], leaf.x - low[0]
            is_hole = ~is_known[rows, columns][leaf.triangles].any(axis=1)
            patches.append(Patch(leaf.x, leaf.y, heights[rows, columns], rows_on_edge, gradient, leaf.triangles, is_hole))
        return self._encode(level, indices, np.zeros(len(indices), np.float32), patches)

    def _simplify(self, level: int, shard: int) -> EncodedPatches:
        layout = self._layout(level)
        positions = np.flatnonzero(layout.shards == shard)
        diamonds = layout.diamonds[layout.shards[layout.diamonds[:, 0]] == shard]
        local = np.where(diamonds < 0, -1, np.searchsorted(positions, diamonds))
        indices = layout.indices[positions]
        children = self._load_children(level, shard, indices) if level + 1 < self._tree.leaf_level else None
        patches = simplify_diamonds(self._tree, level, indices, local, children, self._folder.grid)
        if level:
            coarser = self._layout(level - 1)
            users = coarser.shards[np.searchsorted(coarser.indices, patches.indices >> 1)]
            write_patches(self._folder.patches_path(level, shard), patches, users)
        corners = self._tree.triangle_corners(level, indices)
        errors = patches.errors + bound_curvature_errors(patches, self._folder.parameters.curvature)
        return self._encode(level, indices, errors, _extract(patches, corners))

    def _load_children(self, level: int, shard: int, indices: np.ndarray) -> PatchSet:
        """Return the existing children of the triangles (N,) of a shard, in ascending order."""
        layout = self._layout(level + 1)
        finer = np.unique(layout.shards[np.isin(layout.indices >> 1, indices)])
        children = join([read_patches(self._folder.patches_path(level + 1, int(number)), shard) for number in finer])
        return children.select(np.argsort(children.indices))

    def _encode(self, level: int, indices: np.ndarray, errors: np.ndarray, patches: list[Patch]) -> EncodedPatches:
        corners = self._tree.triangle_corners(level, indices)
        is_leaf, gradient_step = level == self._tree.leaf_level, self._folder.parameters.gradient_step
        blocks = encode_patches(patches, corners, is_leaf, gradient_step)
        outlines = [count_outline_triangles(patch, corner) for patch, corner in zip(patches, corners, strict=True)]
        return EncodedPatches(
            indices,
            errors,
            np.array([(patch.z.min(), patch.z.max()) for patch in patches], np.int32),
            np.array([(len(patch.x), len(patch.triangles), count) for patch, count in zip(patches, outlines, strict=True)], np.int32),
            np.array([len(block) for block in blocks], np.int64),
            np.frombuffer(b"".join(blocks), np.uint8),
        )


def _extract(patches: PatchSet, corners: np.ndarray) -> list[Patch]:
    """Return the patches of a set with their corners (P, 3, 2) in the bintree."""
    boundary, starts = find_boundaries(patches.x, patches.y, corners, np.diff(patches.vertex_starts))
    gradients, result = patches.gradients[boundary], []
    for row in range(len(patches)):
        vertices, on_edges = slice(*patches.vertex_starts[row : row + 2]), slice(*starts[row : row + 2])
        triangles = slice(*patches.triangle_starts[row : row + 2])
        axes = (axis[vertices] for axis in (patches.x, patches.y, patches.z))
        of_patch = (boundary[on_edges] - vertices.start).astype(np.int32)
        result.append(Patch(*axes, of_patch, gradients[on_edges], patches.triangles[triangles], patches.is_hole[triangles]))
    return result
