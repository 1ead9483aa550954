"""The terrain around a viewer: the blocks that change with each move, and the whole terrain as one mesh."""

from collections.abc import Iterator
from dataclasses import dataclass
from queue import SimpleQueue

import numpy as np

from ..errors import GeometryError, SettingsError
from ..jobs.chunks import map_ordered, slices
from ..jobs.progress import Progress, StageClock, Steps, subprogress
from .blocks import BlockIndex, BlockMesh, compute_signatures, extract_blocks
from .clearings import find_clearing
from .files.readers import READERS, Readers
from .layout import is_same_layout, layout_around, visible_blocks
from .nested import NestedBoxes
from .settings import ClipboxSettings
from .terrains.edits import NO_EDITS, Edits
from .terrains.generators import build_sampler

BLOCK_SIZE = 32  # voxels per side; smaller blocks cost more overhead than work
MAX_BATCH_BLOCKS = 32  # blocks that are processed at once
VOXELS_FRACTION = 0.5  # progress at which all voxels are computed
MAX_COORDINATE = 2.0**46  # voxels from the origin; beyond it double precision does not resolve voxels well
NO_SURFACE = "The boxes contain no surface. Move closer to the ground, or increase Boxes or Voxel Size."
OUT_OF_MEMORY = "The boxes need more memory than is available; reduce Resolution or Boxes."

BlockKey = tuple[int, BlockIndex]  # level and index


@dataclass(frozen=True)
class Update:
    """The changes of a move.

    Attributes:
        viewer: (3,) float64, scene units, around whom the boxes lie.
        meshes: surfaces of new and changed blocks; blocks without a surface are left out.
        removed: blocks whose surface is to be removed.
        is_complete: whether `meshes` holds all blocks of the terrain.
        changed_count: number of blocks that were polygonized.
        left_out: number of innermost boxes that are not shown.
    """

    viewer: np.ndarray
    meshes: dict[BlockKey, BlockMesh]
    removed: list[BlockKey]
    is_complete: bool
    changed_count: int
    left_out: int


class TerrainEngine:
    """Nested boxes that follow a viewer. Only one thread at a time may use it.

    Attributes:
        settings: how the terrain is made.
        edits: solids that are added to it and subtracted from it.
        clock: seconds of all moves by stage.
        boxes: the voxels.
        finished_blocks: blocks that the current move has finished, which may be shown early; every move starts with an empty queue.
        moves: number of moves.
        initial_voxels: voxels computed by the first move.
        warnings: sentences for the user about the source file.
    """

    def __init__(self, settings: ClipboxSettings, readers: Readers = READERS, closed: bool = False, edits: Edits = NO_EDITS) -> None:
        """Read the formula or source file of the terrain. `closed` as in `NestedBoxes`.

        Raises:
            SettingsError, FileError: it cannot be read.
        """
        self.settings, self.edits = settings, edits
        self.clock = StageClock()
        self._sampler = build_sampler(settings, readers, edits)
        self.warnings = self._sampler.warnings
        self.boxes = NestedBoxes(self._sampler, settings, closed)
        self.finished_blocks: SimpleQueue[tuple[BlockKey, BlockMesh]] = SimpleQueue()
        self.moves = 0
        self.initial_voxels = 0
        self._signatures: dict[BlockKey, tuple] = {}
        self._triangle_counts: dict[BlockKey, int] = {}

    def move(self, viewer: np.ndarray) -> Steps[Update]:
        """Center the boxes on a viewer at (3,) float64 scene units. If it is cancelled or fails, the reported state stays valid.

        Raises:
            GeometryError: the position is invalid, or the density function fails. SettingsError: there is too little memory.
        """
        return (yield from self.move_quickly(viewer, 0.0))

    def move_quickly(self, viewer: np.ndarray, travel: float) -> Steps[Update]:
        """Center the boxes on a viewer as `move` does, but leave out the innermost boxes, which the viewer will have left on a path of the
        length `travel`, scene units (section 3.6 of the paper, which updates them less often)."""
        check_viewer(viewer, self.settings.voxel_size)
        try:
            return (yield from self._move(viewer, travel))
        except MemoryError:
            raise SettingsError(OUT_OF_MEMORY, ("resolution", "boxes")) from None

    def _move(self, viewer: np.ndarray, travel: float) -> Steps[Update]:
        self.finished_blocks = SimpleQueue()
        with self.clock.stage("voxels"):
            yield from subprogress(self.boxes.move(viewer, travel), 0.0, VOXELS_FRACTION)
        self.moves += 1
        self.initial_voxels = self.initial_voxels or sum(grid.computed for grid in self.boxes.grids)
        with self.clock.stage("surface"):
            return (yield from subprogress(self._polygonize(viewer), VOXELS_FRACTION, 1.0))

    def find_clearing(self, position: np.ndarray) -> np.ndarray:
        """Return the lowest position (3,) at or above `position` where a viewer can stand, see `clearings.find_clearing`."""
        return find_clearing(self._sampler, position, self.settings.voxel_size)

    def is_settled_at(self, viewer: np.ndarray) -> bool:
        """Return whether a move to `viewer` (3,) would change nothing."""
        return bool(self._signatures) and self.boxes.is_centered_on(viewer)

    @staticmethod
    def has_same_layout(settings: ClipboxSettings, viewer: np.ndarray, other: np.ndarray) -> bool:
        """Return whether the boxes around two viewers (3,) have the same positions."""
        return is_same_layout(layout_around(viewer, settings), layout_around(other, settings))

    def invalidate(self) -> None:
        """Forget which blocks are shown: the next update contains all blocks."""
        self._signatures, self._triangle_counts = {}, {}

    def _polygonize(self, viewer: np.ndarray) -> Steps[Update]:
        """Polygonize the blocks whose signature has changed. The terrain itself never changes, so all others keep their surface."""
        signatures = {
            (level, block): signature
            for level in range(self.boxes.layout.first_level, self.settings.boxes)
            for block, signature in compute_signatures(
                self.boxes, level, visible_blocks(self.boxes.layout, level, BLOCK_SIZE), BLOCK_SIZE
            ).items()
        }
        changed = [key for key, signature in signatures.items() if self._signatures.get(key) != signature]
        meshes: dict[BlockKey, BlockMesh] = {}
        batches = _split_into_batches(changed)
        yield Progress(0.0, "Extracting surface")
        batch_meshes = map_ordered(lambda batch: extract_blocks(self.boxes, *batch, BLOCK_SIZE), batches)
        for index, ((level, _), new_meshes) in enumerate(zip(batches, batch_meshes, strict=True)):
            for block, mesh in new_meshes.items():
                meshes[level, block] = mesh
                self.finished_blocks.put(((level, block), mesh))
            yield Progress((index + 1) / len(batches), f"Extracting surface of box {level + 1}")
        removed = [
            key
            for key in sorted(self._triangle_counts)
            if key not in signatures or (self._signatures[key] != signatures[key] and key not in meshes)
        ]
        is_complete = not self._signatures
        counts = self._triangle_counts | {key: len(mesh.triangles) for key, mesh in meshes.items()}
        self._signatures, self._triangle_counts = signatures, {key: count for key, count in counts.items() if key not in set(removed)}
        left_out = self.boxes.layout.first_level - self.boxes.finest_level
        return Update(np.array(viewer, np.float64), meshes, removed, is_complete, len(changed), left_out)

    def extract_all(self) -> Iterator[BlockMesh]:
        """Extract the surfaces of all blocks of the terrain again."""
        for level, blocks in _split_into_batches(list(self._triangle_counts)):
            yield from extract_blocks(self.boxes, level, blocks, BLOCK_SIZE).values()

    def statistics(self) -> list[dict[str, float]]:
        """Return figures per box: voxel size and side in scene units, triangles, voxels computed and reused by all moves.

        Subdivided boxes have no voxels; their triangles count with the box around them.
        """
        boxes = []
        for level, grid in enumerate(self.boxes.grids, self.boxes.finest_level):
            triangles = sum(count for key, count in self._triangle_counts.items() if key[0] == level)
            moved = grid.computed + grid.reused - grid.side**3
            reused_fraction = None if moved <= 0 else round(grid.reused / moved, 4)
            sizes = {"voxel_size": grid.voxel_size, "side": grid.voxel_size * grid.side, "triangles": triangles}
            boxes.append(sizes | {"computed": grid.computed, "reused": grid.reused, "reused_fraction": reused_fraction})
        return boxes


def _split_into_batches(keys: list[BlockKey]) -> list[tuple[int, list[BlockIndex]]]:
    """Group blocks by level, at most MAX_BATCH_BLOCKS per batch."""
    levels: dict[int, list[BlockIndex]] = {}
    for level, block in keys:
        levels.setdefault(level, []).append(block)
    return [(level, blocks[rows]) for level, blocks in levels.items() for rows in slices(len(blocks), MAX_BATCH_BLOCKS)]


@dataclass(frozen=True)
class WeldedMesh:
    """A mesh with shared vertices: vertices (V, 3) float64 scene units, triangles (T, 3) int32.

    normals: (V, 3) float32, or None to use the face normals.
    """

    vertices: np.ndarray
    normals: np.ndarray | None
    triangles: np.ndarray


def weld(meshes: list[BlockMesh]) -> WeldedMesh:
    """Join blocks at vertices with the same corner and cycle.

    Raises:
        GeometryError: there is no surface.
    """
    if not meshes:
        raise GeometryError(NO_SURFACE)
    corners = np.concatenate([mesh.corners for mesh in meshes])
    spans = np.ptp(corners, axis=0).astype(np.int64) + 1
    indices = corners - corners.min(axis=0)
    keys = ((indices[:, 0] * spans[1] + indices[:, 1]) * spans[2] + indices[:, 2]) * 16 + np.concatenate([mesh.cycles for mesh in meshes])
    _, first, new_indices = np.unique(keys, return_index=True, return_inverse=True)
    starts = np.cumsum([0] + [len(mesh.corners) for mesh in meshes[:-1]])
    triangles = np.concatenate([mesh.triangles.astype(np.int64) + start for mesh, start in zip(meshes, starts, strict=True)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])[first]
    normals = np.concatenate([mesh.normals for mesh in meshes])[first]
    return WeldedMesh(vertices, normals, new_indices.reshape(-1)[triangles].astype(np.int32))


def check_viewer(viewer: np.ndarray, voxel_size: float) -> None:
    """Raise GeometryError when boxes cannot be centered on `viewer` (3,)."""
    if not np.isfinite(viewer).all() or (np.abs(viewer) > MAX_COORDINATE * voxel_size).any():
        position = ", ".join(f"{coordinate:g}" for coordinate in viewer)
        raise GeometryError(f"Position {position} is too far from the origin (maximum {MAX_COORDINATE * voxel_size:g}).")
