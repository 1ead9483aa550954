"""The structure file of a store: everything but the contents of patches and texture tiles.

A file of blocks (see `files.blocks`) of the kind `bdamstru`. Block 0 is a JSON object, see `StoreHeader`. Then follow, for every level from
0, five blocks with little-endian arrays over the N patches of the level in ascending order of their bintree indices. All but the first one
are compressed by Zstandard: the lowest bytes of the first column, then the second lowest ones and so on, then those of the other columns.

| block | content |
|---|---|
| 5 level + 1 | bintree indices, N uint64 |
| 5 level + 2 | errors in meters, N float32: the largest of the patch and of the finer patches in the same triangle |
| 5 level + 3 | lowest and highest height in steps, N x 2 int32 |
| 5 level + 4 | numbers of vertices, of triangles, and of triangles of the outline (see `patch_outlines`), N x 3 uint32 |
| 5 level + 5 | bounding boxes in the local frame, N x 6 float32: lowest and highest x, y, z in meters, with finer patches |

The patches of level 0, then of level 1 and so on, are the blocks of the geometry file in the same order.
The backup of the file (see `files.backups`) is a copy of it.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from ...errors import FileError
from ...files import file_access
from ...files.backups import FileDamage, backup_path, copy_to_backup, read_either
from ...files.blocks import BlockReader, BlockWriter
from ...geometry.placements import Frame, GeographicFrame, ProjectedFrame
from ...json_values import boolean, integer, number, numbers, parse_json, text
from ..tree import Tree

KIND, STRUCTURE_FILE = "bdamstru", "structure.bdam"
# The version of the contents of the header. 2: gradients of patches have another name, errors include the curvature of geographic grids. 3:
# structures name the files that they belong to, patches have triangles of outlines. 4: stores may have normal maps. 5: patches are Rice
# codes, arrays of structures are compressed.
VERSION = OLDEST_VERSION = 5
ARRAYS_PER_LEVEL = 5
COLUMNS = (1, 1, 2, 3, 6)  # numbers of a patch in each of them
COMPRESSION_LEVEL = 9
FRAMES = {"projected": ProjectedFrame, "geographic": GeographicFrame}
# Limits of what a build writes, with room to spare. Numbers within them fit into the types of all arrays that are computed from them.
MAX_SAMPLES = 2**28  # along each side
MAX_LEAF_CELLS = 64
MAX_GRID_FRACTION = 4  # vertices of a patch, relative to the samples of a square of leaf_cells; a patch has 0.6 times as many
MAX_STEP, MIN_STEP = 1e9, 1e-15  # meters, degrees or steps between two values
MAX_METERS = 1e18  # coordinates, heights and errors
MAX_DEGREES = 1e3


@dataclass(frozen=True)
class StoreHeader:
    """What is the same for a whole store.

    Attributes:
        rows, columns, leaf_cells: see `Tree`.
        height_step: meters between two stored heights.
        gradient_step: unit of stored gradients, in steps per cell.
        cell_size: nominal meters between two samples.
        crs: the coordinate reference system in words.
        frame: "projected" or "geographic".
        first, step, origin: position of the grid in the frame, see `fields.placements`.
        has_texture: whether there is a folder of textures.
        has_normals: whether there is a folder of normal maps.
        geometry_checksum: checksum of the index of the geometry file that belongs to the structure.
    """

    rows: int
    columns: int
    leaf_cells: int
    height_step: float
    gradient_step: float
    cell_size: float
    crs: str
    frame: str
    first: tuple[float, float]
    step: tuple[float, float]
    origin: tuple[float, float]
    has_texture: bool = False
    has_normals: bool = False
    geometry_checksum: int = 0

    @property
    def tree(self) -> Tree:
        """The bintrees."""
        return Tree(self.rows, self.columns, self.leaf_cells)

    def create_frame(self) -> Frame:
        """Return the local frame."""
        return FRAMES[self.frame](tuple(self.first), tuple(self.step), tuple(self.origin))


@dataclass(frozen=True)
class Level:
    """The patches of a level.

    Attributes:
        indices: (N,) int64, triangles of the bintree, ascending.
        errors: (N,) float32, meters.
        heights: (N, 2) int32, the lowest and the highest one, in steps.
        counts: (N, 3) int32, vertices, triangles, and triangles of the outline.
        low, high: (N, 3) float32, bounding boxes in local meters.
    """

    indices: np.ndarray
    errors: np.ndarray
    heights: np.ndarray
    counts: np.ndarray
    low: np.ndarray
    high: np.ndarray


def write_structure(folder: Path, header: StoreHeader, levels: list[Level]) -> None:
    """Write the structure file of a store and its backup. Raises FileError."""
    with BlockWriter(folder / STRUCTURE_FILE, KIND) as writer:
        writer.append(json.dumps({"version": VERSION, **asdict(header)}, sort_keys=True).encode())
        for level in levels:
            writer.append(level.indices.astype("<u8").tobytes())
            writer.append(compress(level.errors[:, None].astype("<f4")))
            writer.append(compress(level.heights.astype("<i4")))
            writer.append(compress(level.counts.astype("<u4")))
            writer.append(compress(np.concatenate([level.low, level.high], axis=1).astype("<f4")))
        writer.finish()
    copy_to_backup(folder / STRUCTURE_FILE)


def find_structure(folder: Path) -> Path | None:
    """Return the path of the structure file in a folder, or that of its backup if it is missing; None if the folder has neither."""
    path = folder / STRUCTURE_FILE
    return next((candidate for candidate in (path, backup_path(path)) if file_access.is_file(candidate)), None)


def read_structure(folder: Path) -> tuple[StoreHeader, list[Level], tuple[FileDamage, ...]]:
    """Read the structure file of a store, or its backup if it is damaged or missing. Returns the damage of either, too.

    Raises:
        FileError: both are missing, damaged, or of another version.
    """
    (header, levels), damages = read_either(folder / STRUCTURE_FILE, _read_file)
    return header, levels, damages


def _read_file(path: Path) -> tuple[StoreHeader, list[Level]]:
    with BlockReader(path, KIND) as reader:
        try:
            content = parse_json(reader.read(0, "header"))
            if not isinstance(content, dict):
                raise ValueError("its header is no object")
            version = integer(content.pop("version"), "version", 0, 2**31)
            if version > VERSION:
                raise FileError(f'"{path}" was written by a newer Farfield (version {version} of the store); update Farfield.')
            if version < OLDEST_VERSION:
                raise FileError(f'"{path}" was written by an older Farfield (version {version} of the store); build the terrain again.')
            header = _check_header(content)
            levels = list(_read_levels(reader, header))
        except (IndexError, KeyError, TypeError, ValueError, zstandard.ZstdError) as error:
            raise FileError(f'"{path}" is damaged or no structure of a terrain ({error}); build the terrain again.') from error
    return header, levels


def _check_header(values: dict[str, Any]) -> StoreHeader:
    """Return the header that has these values. Raises ValueError, KeyError or TypeError if a value has another type or is out of range."""
    if values.keys() != {field.name for field in fields(StoreHeader)}:
        raise ValueError("its header has other fields")
    if values["frame"] not in tuple(FRAMES):
        raise ValueError("the frame is unknown")
    farthest = MAX_DEGREES if values["frame"] == "geographic" else MAX_METERS
    header = StoreHeader(
        rows=integer(values["rows"], "rows", 2, MAX_SAMPLES),
        columns=integer(values["columns"], "columns", 2, MAX_SAMPLES),
        leaf_cells=integer(values["leaf_cells"], "leaf_cells", 2, MAX_LEAF_CELLS),
        **{name: number(values[name], name, MIN_STEP, MAX_STEP) for name in ("height_step", "gradient_step", "cell_size")},
        crs=text(values["crs"], "crs"),
        frame=values["frame"],
        first=numbers(values["first"], "first", 2, -farthest, farthest),
        step=numbers(values["step"], "step", 2, MIN_STEP, MAX_STEP),
        origin=numbers(values["origin"], "origin", 2, -farthest, farthest),
        **{name: boolean(values[name], name) for name in ("has_texture", "has_normals")},
        geometry_checksum=integer(values["geometry_checksum"], "geometry_checksum", 0, 2**32 - 1),
    )
    if header.leaf_cells % 2:
        raise ValueError("leaf_cells is odd")
    return header


def _read_levels(reader: BlockReader, header: StoreHeader) -> Iterator[Level]:
    """Yield the levels. Raises ValueError if their patches are none of the bintree, or a number is out of range."""
    level_count = header.tree.leaf_level + 1
    if len(reader) != 1 + ARRAYS_PER_LEVEL * level_count:
        raise ValueError(f"it has another number of levels than {level_count}")
    parents = np.zeros(1, np.int64)  # the root square, whose halves are the patches of level 0
    for level in range(level_count):
        blocks = [reader.read(ARRAYS_PER_LEVEL * level + number, f"level {level}") for number in range(1, ARRAYS_PER_LEVEL + 1)]
        indices = np.frombuffer(blocks[0], "<u8").astype(np.int64)
        errors, heights, counts, boxes = (
            decompress(block, len(indices), columns, dtype)
            for block, columns, dtype in zip(blocks[1:], COLUMNS[1:], ("<f4", "<i4", "<u4", "<f4"), strict=True)
        )
        patches = Level(indices, errors[:, 0], heights, counts.astype(np.int32), boxes[:, :3], boxes[:, 3:])
        _check_level(patches, header, parents, level)
        yield patches
        parents = patches.indices


def compress(array: np.ndarray) -> bytes:
    """Return an array (N, C) of numbers of four bytes as a block."""
    planes = array.T.copy().view(np.uint8).reshape(array.shape[1], -1, array.itemsize).transpose(0, 2, 1)
    return zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(planes.tobytes())


def decompress(block: bytes, count: int, columns: int, dtype: str) -> np.ndarray:
    """Return the array (count, columns) of a block. Raises ValueError or ZstdError if it has another size, before that is allocated."""
    size = 4 * count * columns
    if zstandard.frame_content_size(block) != size:
        raise ValueError("its arrays have different lengths")
    planes = np.frombuffer(zstandard.ZstdDecompressor().decompress(block, max_output_size=size), np.uint8)
    return np.ascontiguousarray(planes.reshape(columns, 4, count).transpose(2, 0, 1)).view(dtype)[..., 0]


def _check_level(patches: Level, header: StoreHeader, parents: np.ndarray, level: int) -> None:
    """Check the patches of a level; its parents are the indices (M,) of the next coarser one. Raises ValueError."""
    indices = patches.indices
    above = indices >> 1
    is_ordered = indices[0] >= 0 and bool((np.diff(indices) > 0).all()) and np.array_equal(above[np.diff(above, prepend=-1) > 0], parents)
    if not is_ordered or (level == 0 and len(indices) != 2):
        raise ValueError(f"level {level} has patches without a parent, or parents without a patch")
    max_vertices = MAX_GRID_FRACTION * (header.leaf_cells + 1) ** 2
    vertices, triangles, outlines = patches.counts.T
    is_possible = vertices.min() >= 3 and vertices.max() <= max_vertices and triangles.min() >= 1 and (triangles < 2 * vertices).all()
    if not is_possible or outlines.min() < 0 or (outlines > triangles).any():
        raise ValueError(f"level {level} has patches with an impossible number of triangles")
    numbers = np.concatenate([patches.errors[:, None], patches.low, patches.high], axis=1)
    is_finite = bool((np.abs(numbers) <= MAX_METERS).all()) and patches.errors.min() >= 0.0  # NaN is not
    if not is_finite or (patches.low > patches.high).any() or (patches.heights[:, 0] > patches.heights[:, 1]).any():
        raise ValueError(f"level {level} has impossible errors, heights or boxes")
