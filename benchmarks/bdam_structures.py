"""Structures of large stores without patches, for `bench_bdam.py`: they take seconds instead of the minutes of a build, and cuts need
nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from bdam_terrains import CELL_SIZE, HEIGHT_STEP, FractalTerrain

from farfield.addon.core.bdam.patch_squares import leaf_squares_of
from farfield.addon.core.bdam.store.blocks import BlockWriter
from farfield.addon.core.bdam.store.structure import Level, StoreHeader, write_structure
from farfield.addon.core.bdam.store.terrain_store import GEOMETRY_FILE, GEOMETRY_KIND
from farfield.addon.core.bdam.tree import Tree

LEAF_CELLS = 32
# Errors as parts of the relief in a patch, by levels above the leaves; medians of a build of FractalTerrain(2049, 1)
ERROR_PARTS = (0.0, 0.006, 0.0106, 0.0145, 0.022, 0.0266, 0.031, 0.034, 0.038, 0.043, 0.045, 0.047, 0.054)
PATCH_SIZE = (550, 1024)  # vertices and triangles


def write_fractal_structure(folder: Path, terrain: FractalTerrain) -> None:
    """Write the structure of a store of a fractal terrain to a new folder, and a geometry file whose blocks are empty.

    Bounding boxes are those of the terrain. Errors grow with the level and the relief as in stores that were built, and are nested.
    """
    tree = Tree(terrain.size, terrain.size, LEAF_CELLS)
    ranges = read_ranges(terrain, tree)
    levels: list[Level] = []
    for number in range(tree.leaf_level, -1, -1):
        indices = tree.existing_triangles(number)
        corners = tree.triangle_corners(number, indices)
        low, high = (np.empty((len(indices), 3), np.float32) for _ in range(2))
        low[:, :2], high[:, :2] = corners.min(axis=1) * CELL_SIZE, corners.max(axis=1) * CELL_SIZE
        if levels:
            parents = np.searchsorted(indices, levels[-1].indices >> 1)
            low[:, 2], high[:, 2] = np.inf, -np.inf
            np.minimum.at(low[:, 2], parents, levels[-1].low[:, 2])
            np.maximum.at(high[:, 2], parents, levels[-1].high[:, 2])
        else:
            column, row = leaf_squares_of(corners, LEAF_CELLS).T
            low[:, 2], high[:, 2] = ranges[0][row, column], ranges[1][row, column]
        errors = (high[:, 2] - low[:, 2]) * ERROR_PARTS[min(tree.leaf_level - number, len(ERROR_PARTS) - 1)]
        diamonds = tree.find_diamonds(number, indices)
        pairs = diamonds[diamonds[:, 1] >= 0]
        errors[pairs] = errors[pairs].max(axis=1)[:, None]
        if levels:
            np.maximum.at(errors, parents, levels[-1].errors)
        heights = np.rint(np.stack([low[:, 2], high[:, 2]], axis=1) / HEIGHT_STEP).astype(np.int32)
        counts = np.tile(np.array(PATCH_SIZE, np.int64), (len(indices), 1))
        levels.append(Level(indices, errors.astype(np.float32), heights, counts, low, high))
    levels.reverse()
    folder.mkdir(parents=True)
    step, start = (CELL_SIZE, CELL_SIZE), (0.0, 0.0)
    with BlockWriter(folder / GEOMETRY_FILE, GEOMETRY_KIND) as writer:
        for _ in range(sum(len(level.indices) for level in levels)):
            writer.append(b"")
        checksum = writer.finish(backs_up_index=True)
    header = StoreHeader(*(terrain.size,) * 2, LEAF_CELLS, HEIGHT_STEP, 1.0, CELL_SIZE, "meters", "projected", start, step, start)
    write_structure(folder, replace(header, geometry_checksum=checksum), levels)


def read_ranges(terrain: FractalTerrain, tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest height (S, S) float32 of the squares of the leaves, row 0 in the south. The side of the terrain
    must be a multiple of that of a leaf."""
    count = (terrain.size - 1) // tree.leaf_cells
    low, high = (np.empty((count, count), np.float32) for _ in range(2))
    for row in range(count):
        heights = terrain.read(slice(row * tree.leaf_cells, (row + 1) * tree.leaf_cells + 1))
        starts = np.arange(0, terrain.size - 1, tree.leaf_cells)
        low[row] = np.minimum.reduceat(heights.min(axis=0), starts)
        high[row] = np.maximum.reduceat(heights.max(axis=0), starts)
    return low, high
