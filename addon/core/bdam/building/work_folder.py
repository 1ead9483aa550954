"""The folder of a build: its parameters, the heights, and the results of its tasks, from which an interrupted build resumes."""

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ...files.sealed_files import read_sealed
from ..tree import Tree
from .height_grid import HeightGrid

PARAMETERS_FILE, HEIGHTS_FILE = "parameters.json", "heights.raw"
ADVICE = "start the build again"


@dataclass(frozen=True)
class BuildParameters:
    """What the tasks of a build need to know.

    Attributes:
        rows, columns: samples of the field.
        leaf_cells: cells along a leg of a leaf.
        gradient_step: unit of stored gradients, in steps per cell.
        diamonds_per_shard: how many diamonds a task simplifies.
        curvature: curvature of straight lines of the grid in the local frame, in cells per square cell.
    """

    rows: int
    columns: int
    leaf_cells: int
    gradient_step: float
    diamonds_per_shard: int
    curvature: float


@dataclass(frozen=True)
class WorkFolder:
    """The work folder of a build at `path`."""

    path: Path
    parameters: BuildParameters

    @staticmethod
    def load(path: Path) -> "WorkFolder":
        """Open a work folder. Raises FileError if its parameters cannot be read."""
        content = json.loads(read_sealed(path / PARAMETERS_FILE, ADVICE))
        return WorkFolder(path, BuildParameters(**content))

    @property
    def parameters_content(self) -> bytes:
        """The content of the file of parameters."""
        return json.dumps(asdict(self.parameters), sort_keys=True).encode()

    @cached_property
    def tree(self) -> Tree:
        """The bintrees."""
        return Tree(self.parameters.rows, self.parameters.columns, self.parameters.leaf_cells)

    @property
    def grid(self) -> HeightGrid:
        """The heights."""
        return HeightGrid(self.path / HEIGHTS_FILE, self.parameters.rows, self.parameters.columns)

    def patches_path(self, level: int, shard: int) -> Path:
        """Return the path of the patches of a shard, for the next coarser level."""
        return self.path / f"patches-{level:02d}-{shard:06d}.shard"

    def blocks_path(self, level: int, shard: int) -> Path:
        """Return the path of the encoded patches of a shard."""
        return self.path / f"blocks-{level:02d}-{shard:06d}.shard"


@dataclass(frozen=True)
class LevelLayout:
    """The triangles of a level and how they are divided into shards.

    indices: (N,) int64, ascending bintree indices of the triangles that exist. diamonds: (D, 2) int64, positions in `indices`, see
    `Tree.find_diamonds`. shards: (N,) int64, the shard of each triangle. count: number of shards.
    """

    indices: np.ndarray
    diamonds: np.ndarray
    shards: np.ndarray
    count: int

    @staticmethod
    def create(tree: Tree, level: int, diamonds_per_shard: int) -> "LevelLayout":
        """Divide a level into runs of diamonds along the space-filling curve."""
        indices = tree.existing_triangles(level)
        diamonds = tree.find_diamonds(level, indices)
        of_diamond = np.arange(len(diamonds)) // diamonds_per_shard
        shards = np.zeros(len(indices), np.int64)
        shards[diamonds[:, 0]] = of_diamond
        is_pair = diamonds[:, 1] >= 0
        shards[diamonds[is_pair, 1]] = of_diamond[is_pair]
        return LevelLayout(indices, diamonds, shards, int(of_diamond[-1]) + 1)
