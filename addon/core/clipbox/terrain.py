"""A terrain about a viewer: what has changed since the last move, block by block, and the whole as one closed mesh."""

from collections.abc import Iterator
from dataclasses import dataclass
from queue import SimpleQueue

import numpy as np

from ..errors import GeometryError
from ..parallel import mapped, slices
from ..progress import Progress, StageClock, Steps, scaled
from .blocks import BlockMesh, Place, block_meshes, signatures
from .layout import blocks_of, layout_about, same_layout
from .nested import NestedBoxes
from .settings import ClipboxSettings
from .terrains import terrain_of

BLOCK = 32  # voxels a side: smaller ones cost more to begin than to fill
BATCH = 32  # blocks that are worked on at once
VOXELS_SHARE = 0.5  # of the bar
FARTHEST = 2.0**46  # voxels from the origin: beyond, double precision tells voxels no longer well apart
NO_SURFACE = "There is no surface within the boxes, only air or only ground; go nearer to one, or make the boxes more or larger."

Key = tuple[int, Place]


@dataclass(frozen=True)
class Update:
    """What a move changes.

    meshes: the surfaces of the blocks that are new, by level and place; those without any surface are not among them. gone: blocks whose
    surface is to be taken away. whole: whether these are all blocks that there are. changed: how many were looked at anew. viewer: (3,)
    float64, about whom the boxes lie, scene units.
    """

    viewer: np.ndarray
    meshes: dict[Key, BlockMesh]
    gone: list[Key]
    whole: bool
    changed: int


class Terrain:
    """Nested boxes that follow a viewer. One thread at a time may use it.

    finished: the blocks that the move under way has finished, for whoever may show them early; a move begins with an empty one.
    clock: seconds of all moves by stage. moves: how many there were. first_computed: voxels that the first one worked out.
    """

    def __init__(self, settings: ClipboxSettings, closed: bool = False) -> None:
        """Read the formula or file that `settings` name. `closed` as in `NestedBoxes`.

        Raises:
            SettingsError, FileError: when that cannot be done.
        """
        self.settings = settings
        self.clock = StageClock()
        self.boxes = NestedBoxes(terrain_of(settings), settings, closed)
        self.finished: SimpleQueue[tuple[Key, BlockMesh]] = SimpleQueue()
        self.moves = 0
        self.first_computed = 0
        self._signatures: dict[Key, tuple] = {}
        self._filled: dict[Key, int] = {}

    def move(self, viewer: np.ndarray) -> Steps[Update]:
        """Let the boxes lie about a viewer at (3,) float64 scene units. When it is stopped or fails, all stays as it was shown.

        Raises:
            GeometryError: when the viewer is nowhere, or the terrain's function fails.
        """
        check_viewer(viewer, self.settings.voxel)
        self.finished = SimpleQueue()
        with self.clock.stage("voxels"):
            yield from scaled(self.boxes.move(viewer), 0.0, VOXELS_SHARE)
        self.moves += 1
        self.first_computed = self.first_computed or sum(volume.computed for volume in self.boxes.volumes)
        with self.clock.stage("surface"):
            return (yield from scaled(self._polygonised(viewer), VOXELS_SHARE, 1.0))

    def lies_about(self, viewer: np.ndarray) -> bool:
        """Whether a move to (3,) `viewer` would change nothing."""
        return bool(self._signatures) and self.boxes.lie_about(viewer)

    @staticmethod
    def same_place(settings: ClipboxSettings, one: np.ndarray, other: np.ndarray) -> bool:
        """Whether boxes about two viewers (3,) lie at the same place."""
        return same_layout(layout_about(one, settings), layout_about(other, settings))

    def forget(self) -> None:
        """Forget what is shown: the next update holds all blocks."""
        self._signatures, self._filled = {}, {}

    def _polygonised(self, viewer: np.ndarray) -> Steps[Update]:
        """The blocks whose surface has changed. What is cut as before has the surface of before, for the terrain never changes."""
        found = {
            (level, block): cut
            for level in range(self.boxes.finest, self.settings.boxes)
            for block, cut in signatures(self.boxes, level, blocks_of(self.boxes.layout, level, BLOCK), BLOCK).items()
        }
        changed = [key for key, cut in found.items() if self._signatures.get(key) != cut]
        meshes: dict[Key, BlockMesh] = {}
        batches = _batches(changed)
        yield Progress(0.0, "Finding the surface")
        made = mapped(lambda batch: block_meshes(self.boxes, *batch, BLOCK), batches)
        for number, ((level, _), of_batch) in enumerate(zip(batches, made, strict=True)):
            for block, mesh in of_batch.items():
                meshes[level, block] = mesh
                self.finished.put(((level, block), mesh))
            yield Progress((number + 1) / len(batches), f"Finding the surface of box {level + 1}")
        gone = [key for key in sorted(self._filled) if key not in found or (self._signatures[key] != found[key] and key not in meshes)]
        whole = not self._signatures
        filled = self._filled | {key: len(mesh.triangles) for key, mesh in meshes.items()}
        self._signatures, self._filled = found, {key: count for key, count in filled.items() if key not in set(gone)}
        return Update(np.array(viewer, np.float64), meshes, gone, whole, len(changed))

    def all_meshes(self) -> Iterator[BlockMesh]:
        """The surfaces of all blocks where the boxes lie now, worked out anew."""
        for level, blocks in _batches(list(self._filled)):
            yield from block_meshes(self.boxes, level, blocks, BLOCK).values()

    def figures(self) -> list[dict[str, float]]:
        """What each box holds: side of its voxels and of itself in scene units, triangles, voxels worked out and kept by all moves.

        Boxes that are made by subdividing have no voxels; their triangles count with the box around them.
        """
        found = []
        for level, volume in enumerate(self.boxes.volumes, self.boxes.finest):
            triangles = sum(count for key, count in self._filled.items() if key[0] == level)
            moved = volume.computed + volume.reused - volume.side**3
            share = None if moved <= 0 else round(volume.reused / moved, 4)
            sizes = {"voxel": volume.voxel, "side": volume.voxel * volume.side, "triangles": triangles}
            found.append(sizes | {"computed": volume.computed, "reused": volume.reused, "reused_share": share})
        return found


def _batches(keys: list[Key]) -> list[tuple[int, list[Place]]]:
    """Blocks of one level each, at most BATCH together."""
    levels: dict[int, list[Place]] = {}
    for level, block in keys:
        levels.setdefault(level, []).append(block)
    return [(level, blocks[rows]) for level, blocks in levels.items() for rows in slices(len(blocks), BATCH)]


@dataclass(frozen=True)
class Welded:
    """A union of blocks: vertices (V, 3) float64 scene units, each once; normals (V, 3) float32, or None for those of the
    faces; triangles (T, 3) int32."""

    vertices: np.ndarray
    normals: np.ndarray | None
    triangles: np.ndarray


def welded(meshes: list[BlockMesh]) -> Welded:
    """The union of blocks, joined by which corner and ring their vertices belong to.

    Raises:
        GeometryError: when there is no surface.
    """
    if not meshes:
        raise GeometryError(NO_SURFACE)
    corners = np.concatenate([mesh.corners for mesh in meshes])
    spans = np.ptp(corners, axis=0).astype(np.int64) + 1
    places = corners - corners.min(axis=0)
    keys = ((places[:, 0] * spans[1] + places[:, 1]) * spans[2] + places[:, 2]) * 16 + np.concatenate([mesh.rings for mesh in meshes])
    _, first, numbers = np.unique(keys, return_index=True, return_inverse=True)
    starts = np.cumsum([0] + [len(mesh.corners) for mesh in meshes[:-1]])
    triangles = np.concatenate([mesh.triangles.astype(np.int64) + start for mesh, start in zip(meshes, starts, strict=True)])
    vertices, normals = (np.concatenate([getattr(mesh, name) for mesh in meshes])[first] for name in ("vertices", "normals"))
    return Welded(vertices, normals, numbers.reshape(-1)[triangles].astype(np.int32))


def check_viewer(viewer: np.ndarray, voxel: float) -> None:
    """Raise GeometryError when boxes cannot lie about `viewer` (3,)."""
    if not np.isfinite(viewer).all() or (np.abs(viewer) > FARTHEST * voxel).any():
        where = ", ".join(f"{each:g}" for each in viewer)
        raise GeometryError(f"No boxes can lie about {where}; the farthest from the origin is {FARTHEST * voxel:g}.")
