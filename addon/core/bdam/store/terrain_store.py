"""A finished terrain: a folder with a structure file, a geometry file and, if the terrain has textures, a folder of these."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from ...errors import FileError
from ..textures.store import TextureStore
from .blocks import BlockReader
from .leaf_grids import leaf_grid
from .patch_codec import Patch, decode_patch
from .structure import STRUCTURE_FILE, read_structure

GEOMETRY_FILE, GEOMETRY_KIND, TEXTURE_FOLDER = "geometry.bdam", "bdamgeom", "textures"


class TerrainStore:
    """An open store. Threads may share it.

    header: see `StoreHeader`. tree: the bintrees. levels: the patches of each level from the coarsest to the finest. children: for each
    level but the last, (N, 2) int64, the rows of the two children of each patch in the next level, -1 where there is none. partners: for
    each level, (N,) int64, the row of the other patch of the diamond, or of the patch itself where there is none. textures: None without
    textures.
    """

    def __init__(self, folder: Path) -> None:
        """Open the store in `folder`.

        Raises:
            FileError: it is no store, is damaged or unfinished, or was written by a newer version.
        """
        self.folder = folder
        if not (folder / STRUCTURE_FILE).is_file():
            raise FileError(
                f'"{folder}" is no terrain built by Farfield: it contains no file "{STRUCTURE_FILE}"; choose the folder of a terrain.'
            )
        self.header, self.levels = read_structure(folder)
        self.tree = self.header.tree
        self.frame = self.header.create_frame()
        self._geometry = BlockReader(folder / GEOMETRY_FILE, GEOMETRY_KIND)
        self._starts = np.concatenate([[0], np.cumsum([len(level.indices) for level in self.levels])])
        if self._geometry.count != self._starts[-1]:
            raise FileError(f'"{folder / GEOMETRY_FILE}" and "{STRUCTURE_FILE}" belong to different terrains; build the terrain again.')
        self.children = [self._find_children(level) for level in range(len(self.levels) - 1)]
        self.partners = [self._find_partners(level) for level in range(len(self.levels))]
        self.textures = TextureStore(folder / TEXTURE_FOLDER) if self.header.has_texture else None

    def __enter__(self) -> "TerrainStore":
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._geometry.close()
        if self.textures is not None:
            self.textures.close()

    def read(self, level: int, row: int) -> Patch:
        """Return the patch in a row of a level.

        Raises:
            FileError: it is damaged.
        """
        patches, index = self.levels[level], int(self.levels[level].indices[row])
        label = self.label(level, row)
        content = self._geometry.read(int(self._starts[level]) + row, label)
        corners = self.tree.corners_of(level, index)
        leaf = leaf_grid(self.tree, corners) if level == self.tree.leaf_level else None
        try:
            return decode_patch(content, corners, *(int(count) for count in patches.counts[row]), leaf, self.header.gradient_step)
        except FileError as error:
            raise FileError(f'Patch {level}/{index} of "{self.folder}" is damaged: {error}') from error

    def label(self, level: int, row: int) -> str:
        """Return the name of a patch for messages."""
        return f"patch {level}/{int(self.levels[level].indices[row])}"

    def verify(self) -> Iterator[str]:
        """Yield the names of damaged patches and texture tiles. Reads the whole store."""
        for number in self._geometry.verify():
            level = int(np.searchsorted(self._starts, number, side="right")) - 1
            yield self.label(level, number - int(self._starts[level]))
        if self.textures is not None:
            for number in self.textures.verify():
                yield self.textures.label(number)

    @cached_property
    def height_range(self) -> tuple[float, float]:
        """The lowest and highest height in meters."""
        heights = self.levels[-1].heights
        return float(heights.min()) * self.header.height_step, float(heights.max()) * self.header.height_step

    def to_local(self, patch: Patch) -> np.ndarray:
        """Return the vertices (V, 3) float64 of a patch in local meters."""
        x, y = self.frame.to_local(patch.x, patch.y)
        return np.stack([x, y, patch.z * self.header.height_step], axis=1)

    def _find_children(self, level: int) -> np.ndarray:
        parents, candidates = self.levels[level].indices, self.levels[level + 1].indices
        wanted = 2 * parents[:, None] + np.arange(2)
        rows = np.minimum(np.searchsorted(candidates, wanted), len(candidates) - 1)
        return np.where(candidates[rows] == wanted, rows, -1)

    def _find_partners(self, level: int) -> np.ndarray:
        indices = self.levels[level].indices
        partners = np.arange(len(indices))
        diamonds = self.tree.find_diamonds(level, indices)
        first, second = diamonds[diamonds[:, 1] >= 0].T
        partners[first], partners[second] = second, first
        return partners
