"""A finished terrain: a folder with a structure file, a geometry file and, if the terrain has textures or normal maps, folders of these.

Both files and those of the textures have backups, see `files.backups`.
"""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.backups import FileDamage
from ...files.blocks import BlockReader
from ..textures.store import TextureStore
from .curvature import curve_levels, find_drop, find_drop_gradients
from .leaf_grids import leaf_grid
from .patch_codec import Patch
from .patch_decoding import CodedPatch, decode_patches
from .patch_links import PatchLimits, find_leaf_squares, find_limits, join_bounds, link_patches
from .structure import STRUCTURE_FILE, find_structure, read_structure

GEOMETRY_FILE, GEOMETRY_KIND, TEXTURE_FOLDER, NORMALS_FOLDER = "geometry.bdam", "bdamgeom", "textures", "normals"
TILE_KINDS = {TEXTURE_FOLDER: "texture tile", NORMALS_FOLDER: "normal map"}


class TerrainStore(AbstractContextManager):
    """An open store. Threads may share it.

    Attributes:
        header: see `StoreHeader`.
        tree: the bintrees.
        frame: the local frame.
        levels: the patches of each level from the coarsest to the finest.
        links: parents, children and partners of patches.
        bounds: (N, 7) float32, bounding boxes and errors of all patches, see `join_bounds`.
        textures: the texture tiles, None without.
        normals: the tiles of normal maps, None without; see `building.sample_normals`.
        file_damages: damages of files whose backup is used, and of backups.
        is_curved: whether positions, bounds and errors are those of ground that the curvature of the Earth lowers.
    """

    def __init__(self, folder: Path, is_curved: bool = False) -> None:
        """Open the store in `folder`.

        Raises:
            FileError: it is no store, is damaged or unfinished, or was written by a newer version.
        """
        self.folder, self.is_curved = folder, is_curved
        if find_structure(folder) is None:
            raise FileError(
                f'"{folder}" is no terrain built by Farfield: it contains no file "{STRUCTURE_FILE}"; choose the folder of a terrain.'
            )
        self.header, self.levels, damages = read_structure(folder)
        self.tree = self.header.tree
        self.frame = self.header.create_frame()
        self._geometry = BlockReader(folder / GEOMETRY_FILE, GEOMETRY_KIND, has_backup=True)
        patch_count = sum(len(level.indices) for level in self.levels)
        if (len(self._geometry), self._geometry.index_checksum) != (patch_count, self.header.geometry_checksum):
            self._geometry.close()
            raise FileError(f'"{folder / GEOMETRY_FILE}" and "{STRUCTURE_FILE}" belong to different terrains; build the terrain again.')
        self.bounds, self.levels = join_bounds(curve_levels(self.levels) if is_curved else self.levels)
        self.links = link_patches(self.levels)
        self.textures = self._open_tiles(TEXTURE_FOLDER) if self.header.has_texture else None
        self.normals = self._open_tiles(NORMALS_FOLDER) if self.header.has_normals else None
        of_tiles = [damage for tiles in self._all_tiles for damage in tiles.damages]
        self.file_damages: tuple[FileDamage, ...] = (*damages, *self._geometry.damages, *of_tiles)
        self._patch_damages: dict[int, str] = {}
        self._limits: tuple[int, PatchLimits | None] = (0, None)

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._geometry.close()
        for tiles in self._all_tiles:
            tiles.close()

    @property
    def _all_tiles(self) -> list[TextureStore]:
        """The texture tiles and the normal maps, as far as there are any."""
        return [tiles for tiles in (self.textures, self.normals) if tiles is not None]

    def _open_tiles(self, name: str) -> TextureStore:
        """Return the tiles in a folder of the store. Raises FileError if they are those of another terrain, too."""
        textures, tree = TextureStore(self.folder / name, TILE_KINDS[name]), self.tree
        grid = textures.grid
        if (grid.columns, grid.rows, grid.size) != (tree.columns, tree.rows, tree.side) or grid.level_count > tree.depth + 1:
            textures.close()
            raise FileError(f'The {name} in "{self.folder}" are those of another terrain; build the terrain again.')
        return textures

    def read(self, level: int, row: int) -> Patch:
        """Return the patch in a row of a level.

        Raises:
            FileError: it is damaged. From then on, cuts avoid it.
        """
        (patch,) = self.read_all([(level, row)])
        if isinstance(patch, FileError):
            raise patch
        return patch

    def read_all(self, places: Sequence[tuple[int, int]]) -> list[Patch | FileError]:
        """Return the patches in levels and rows, in a fraction of the time that `read` takes for one after the other.

        Those that are damaged are errors instead. From then on, cuts avoid them.
        """
        try:
            patches: list[Patch | FileError] = list(self._decode(places))
        except FileError as error:
            patches = [error] if len(places) == 1 else [patch for place in places for patch in self.read_all([place])]
        for (level, row), patch in zip(places, patches, strict=True):
            if isinstance(patch, FileError):
                self._patch_damages[int(self.links.starts[level]) + row] = str(patch)
        return patches

    @property
    def damage_count(self) -> int:
        """The number of patches that could not be read so far."""
        return len(self._patch_damages)

    def attempts(self) -> Iterator[int]:
        """Yield 0, and further numbers as long as patches have turned out to be damaged since the last one: choose a cut each time."""
        number, known_damages = 0, -1
        while known_damages != self.damage_count:
            known_damages = self.damage_count
            yield number
            number += 1

    @property
    def damages(self) -> tuple[str, ...]:
        """Sentences about what was found to be damaged so far."""
        return (*(damage.sentence for damage in self.file_damages), *tuple(self._patch_damages.values()))

    @property
    def limits(self) -> PatchLimits | None:
        """How cuts avoid the patches that could not be read so far, None if all could be read."""
        count, limits = self._limits
        if count != self.damage_count:
            numbers = list(self._patch_damages)
            is_damaged = np.zeros(len(self.links.parents), bool)
            is_damaged[numbers] = True
            limits = find_limits(self.links, is_damaged)
            self._limits = len(numbers), limits
        return limits

    def _decode(self, places: Sequence[tuple[int, int]]) -> list[Patch]:
        """Return the patches in levels and rows. Raises FileError, which names the patch if it is the only one."""
        coded = []
        for level, row in places:
            content = self._geometry.read(int(self.links.starts[level]) + row, self.label(level, row))
            corners = self.corners_of(level, row)
            leaf = leaf_grid(self.tree, corners) if level == self.tree.leaf_level else None
            coded.append(CodedPatch(content, corners, *self.levels[level].counts[row, :2].tolist(), leaf))
        try:
            return decode_patches(coded, self.header.gradient_step)
        except FileError as error:
            level, row = places[0]
            index = int(self.levels[level].indices[row])
            raise FileError(f'Patch {level}/{index} of "{self.folder}" is damaged: {error}') from error

    def label(self, level: int, row: int) -> str:
        """Return the name of a patch for messages."""
        return f"patch {level}/{int(self.levels[level].indices[row])}"

    def verify(self) -> Iterator[str]:
        """Yield the names of damaged files, patches and texture tiles. Reads the whole store, except for files that opening it has read."""
        for damage in self.file_damages:
            yield damage.name
        for number in self._geometry.verify():
            yield self.label(*self.links.locate(number))
        for tiles in self._all_tiles:
            for number in tiles.verify():
                yield tiles.label(number)

    @cached_property
    def leaf_squares(self) -> list[np.ndarray]:
        """The squares of the patches of each level, see `find_leaf_squares`."""
        return find_leaf_squares(self.tree, self.levels)

    @cached_property
    def height_range(self) -> tuple[float, float]:
        """The lowest and highest height in meters."""
        heights = self.levels[-1].heights
        return float(heights.min()) * self.header.height_step, float(heights.max()) * self.header.height_step

    def to_local(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return vertices at `x` and `y` in the grid with heights `z` in steps, of any shape, in local meters, (..., 3) float64."""
        east, north = self.frame.to_local(x, y)
        heights = z * self.header.height_step
        return np.stack([east, north, heights - find_drop(east, north) if self.is_curved else heights], axis=-1)

    def to_local_gradients(self, x: np.ndarray, y: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """Return the derivatives (N, 2) float64 of local z along local x and y from `gradients` (N, 2), steps per cell, at samples (N,)."""
        local = self.frame.to_local_gradients(x, y, gradients * self.header.height_step)
        return local - find_drop_gradients(*self.frame.to_local(x, y)) if self.is_curved else local

    def corners_of(self, level: int, row: int) -> np.ndarray:
        """Return the corners (3, 2) int64 of a patch in the grid; see `Tree.corners_of`."""
        return self.tree.corners_of(level, int(self.levels[level].indices[row]))
