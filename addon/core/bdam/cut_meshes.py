"""Meshes of cuts: patches with normals, and their union."""

import threading
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from .extraction import Cut
from .store.patch_codec import Patch
from .store.terrain_store import TerrainStore

DEFAULT_CACHE_BYTES = 64 << 20


@dataclass(frozen=True)
class PatchMesh:
    """A patch ready to be shown, without holes.

    ids: (V,) int64, numbers of the vertices in the grid: row * columns + column. positions: (V, 3) float64, local meters without
    exaggeration. normals: (V, 3) float32. triangles: (T, 3) int32, counterclockwise seen from above.
    """

    ids: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray

    @property
    def byte_count(self) -> int:
        """Bytes of the arrays."""
        return self.ids.nbytes + self.positions.nbytes + self.normals.nbytes + self.triangles.nbytes


@dataclass(frozen=True)
class CutMesh:
    """The union of patches, whose common vertices are merged.

    ids, positions, normals: see `PatchMesh`. triangles: (T, 3) int32. levels: (T,) int8, levels of the patches.
    """

    ids: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    levels: np.ndarray


class PatchCache:
    """Reads patches and keeps those used last, up to a number of bytes. Threads may share it."""

    def __init__(self, store: TerrainStore, max_bytes: int = DEFAULT_CACHE_BYTES) -> None:
        self._store, self._max_bytes = store, max_bytes
        self._meshes: OrderedDict[tuple[int, int], PatchMesh] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def byte_count(self) -> int:
        """Bytes of the patches that are kept."""
        return self._bytes

    def get(self, level: int, row: int) -> PatchMesh:
        """Return the mesh of a patch.

        Raises:
            FileError: the patch is damaged.
        """
        key = (level, row)
        with self._lock:
            if key in self._meshes:
                self._meshes.move_to_end(key)
                return self._meshes[key]
        mesh = build_patch_mesh(self._store, self._store.read(level, row))
        with self._lock:
            if key not in self._meshes:
                self._meshes[key] = mesh
                self._bytes += mesh.byte_count
            while self._bytes > self._max_bytes and len(self._meshes) > 1:
                self._bytes -= self._meshes.popitem(last=False)[1].byte_count
        return mesh


def build_patch_mesh(store: TerrainStore, patch: Patch) -> PatchMesh:
    """Return the mesh of a patch. Normals on its boundary come from the store, so that neighbors agree; the others from its triangles."""
    positions = store.to_local(patch)
    ids = patch.y.astype(np.int64) * store.header.columns + patch.x
    gradients = vertex_gradients(patch)
    gradients[patch.boundary] = patch.gradients
    step_x, step_y = _cell_sizes(store, patch)
    scale = store.header.height_step
    normals = np.stack([-gradients[:, 0] * (scale / step_x), -gradients[:, 1] * (scale / step_y), np.ones(len(gradients))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PatchMesh(ids, positions, normals.astype(np.float32), patch.triangles[~patch.is_hole])


def vertex_gradients(patch: Patch) -> np.ndarray:
    """Return the derivatives (V, 2) float64 of the height along x and y, in steps per cell: means of triangles weighted by area."""
    (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = (axis.astype(np.float64)[patch.triangles].T for axis in (patch.x, patch.y, patch.z))
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    along_x = (z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)
    along_y = (z2 - z0) * (x1 - x0) - (z1 - z0) * (x2 - x0)
    corners, count = patch.triangles.reshape(-1), len(patch.x)
    sums = [np.bincount(corners, np.repeat(values, 3), minlength=count) for values in (along_x, along_y, area)]
    return np.stack(sums[:2], axis=1) / np.maximum(sums[2], 1.0)[:, None]


def merge_patches(meshes: list[PatchMesh], levels: np.ndarray) -> CutMesh:
    """Return the union of patches with their `levels` (N,)."""
    ids = np.concatenate([mesh.ids for mesh in meshes])
    unique, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    starts = np.cumsum([0] + [len(mesh.ids) for mesh in meshes[:-1]])
    triangles = np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)])
    counts = [len(mesh.triangles) for mesh in meshes]
    return CutMesh(
        unique,
        np.concatenate([mesh.positions for mesh in meshes])[first],
        np.concatenate([mesh.normals for mesh in meshes])[first],
        inverse.reshape(-1).astype(np.int32)[triangles],
        np.repeat(levels.astype(np.int8), counts),
    )


def remove_unused(mesh: CutMesh) -> CutMesh:
    """Return a mesh without vertices that only triangles in holes have used."""
    is_used = np.zeros(len(mesh.ids), bool)
    is_used[mesh.triangles] = True
    if is_used.all():
        return mesh
    numbers = np.cumsum(is_used, dtype=np.int32) - 1
    return CutMesh(mesh.ids[is_used], mesh.positions[is_used], mesh.normals[is_used], numbers[mesh.triangles], mesh.levels)


def build_cut_mesh(cache: PatchCache, cut: Cut) -> CutMesh:
    """Return the mesh of a whole cut.

    Raises:
        FileError: a patch is damaged.
    """
    return merge_patches([cache.get(int(level), int(row)) for level, row in zip(cut.levels, cut.rows, strict=True)], cut.levels)


def _cell_sizes(store: TerrainStore, patch: Patch) -> tuple[float, float]:
    """Return the meters along x and y of a cell at the center of a patch."""
    x, y = float(patch.x.mean()), float(patch.y.mean())
    (x0, x1, x2), (y0, y1, y2) = store.frame.to_local(np.array([x, x + 1.0, x]), np.array([y, y, y + 1.0]))
    return float(np.hypot(x1 - x0, y1 - y0)), float(np.hypot(x2 - x0, y2 - y0))
