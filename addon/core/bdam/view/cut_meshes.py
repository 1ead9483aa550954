"""Meshes of cuts: patches with normals, and their union."""

from dataclasses import dataclass

import numpy as np

from ..height_meshes import find_used, sum_gradients
from ..store.patch_codec import Patch
from ..store.terrain_store import TerrainStore

MIN_AREA = 1e-60  # square meters, instead of none; far less than that of any triangle between samples


@dataclass(frozen=True)
class PatchMesh:
    """A patch ready to be shown, without holes.

    Attributes:
        ids: (V,) int32, or int64 in large grids, numbers of the vertices in the grid: row * columns + column.
        positions: (V, 3) float64, local meters without exaggeration.
        normals: (V, 3) float32, unit vectors.
        triangles: (T, 3) int32, counterclockwise seen from above.
        boundary: (B,) int32, the vertices that other patches may have, too.
    """

    ids: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    boundary: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return sum(array.nbytes for array in (self.ids, self.positions, self.normals, self.triangles, self.boundary))


@dataclass(frozen=True)
class CutMesh:
    """The union of patches, whose common vertices are merged.

    Attributes:
        ids: (V,) int64, see `PatchMesh`.
        positions, normals: see `PatchMesh`.
        triangles: (T, 3) int32, counterclockwise seen from above.
        levels: (T,) int8, levels of the patches.
    """

    ids: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    levels: np.ndarray


def build_patch_mesh(store: TerrainStore, patch: Patch) -> PatchMesh:
    """Return the mesh of a patch. Normals on its boundary come from the store, so that neighbors agree; the others from its triangles."""
    positions = store.to_local(patch.x, patch.y, patch.z)
    ids = _number_vertices(store, patch.x, patch.y)
    boundary = patch.boundary
    gradients = vertex_gradients(positions, patch.triangles)
    gradients[:, boundary] = store.to_local_gradients(patch.x[boundary], patch.y[boundary], patch.gradients).T
    triangles = patch.triangles[~patch.is_hole] if patch.is_hole.any() else patch.triangles
    return PatchMesh(ids, positions, _to_normals(gradients), triangles, boundary)


def build_outline_mesh(store: TerrainStore, patch: Patch, triangles: np.ndarray) -> PatchMesh:
    """Return the mesh of the outline of a patch with the triangles (T, 3) that `triangulate_outline` returns."""
    x, y, z = (values[patch.boundary] for values in (patch.x, patch.y, patch.z))
    gradients = store.to_local_gradients(x, y, patch.gradients).T
    boundary = np.arange(len(x), dtype=np.int32)
    return PatchMesh(_number_vertices(store, x, y), store.to_local(x, y, z), _to_normals(gradients), triangles, boundary)


def _number_vertices(store: TerrainStore, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the numbers (V,) of vertices in the grid; see `PatchMesh`."""
    rows, columns = store.header.rows, store.header.columns
    dtype = np.int32 if rows * columns <= np.iinfo(np.int32).max else np.int64
    return y.astype(dtype) * dtype(columns) + x.astype(dtype)


def _to_normals(gradients: np.ndarray) -> np.ndarray:
    """Return unit normals (V, 3) float32 of gradients (2, V) float64."""
    normals = np.empty((gradients.shape[1], 3), np.float32)
    scale = 1.0 / np.sqrt(1.0 + gradients[0] * gradients[0] + gradients[1] * gradients[1])
    normals[:, 2] = scale
    np.multiply(gradients[0], -scale, out=normals[:, 0], casting="same_kind")
    np.multiply(gradients[1], -scale, out=normals[:, 1], casting="same_kind")
    return normals


def vertex_gradients(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the derivatives (2, V) float64 of z along x and y at vertices (V, 3): means of triangles (T, 3) weighted by area."""
    sums = sum_gradients(positions.T.copy(), triangles.T.astype(np.intp, order="C"))
    return np.stack(sums[:2]) / np.maximum(sums[2], MIN_AREA)


def merge_patches(meshes: list[PatchMesh], levels: np.ndarray) -> CutMesh:
    """Return the union of patches with their `levels` (N,)."""
    starts = np.cumsum([0] + [len(mesh.ids) for mesh in meshes[:-1]])
    counts = [len(mesh.triangles) for mesh in meshes]
    ids = np.concatenate([mesh.ids for mesh in meshes])
    boundary = np.concatenate([mesh.boundary + start for mesh, start in zip(meshes, starts, strict=True)])
    _, first, inverse = np.unique(ids[boundary], return_index=True, return_inverse=True)
    is_kept = np.ones(len(ids), bool)
    is_kept[boundary] = False
    is_kept[boundary[first]] = True
    numbers = np.cumsum(is_kept, dtype=np.int32) - np.int32(1)
    numbers[boundary] = numbers[boundary[first]][inverse.reshape(-1)]
    kept = np.flatnonzero(is_kept)
    return CutMesh(
        ids[kept].astype(np.int64),
        np.concatenate([mesh.positions for mesh in meshes]).take(kept, axis=0),
        np.concatenate([mesh.normals for mesh in meshes]).take(kept, axis=0),
        numbers.take(np.concatenate([mesh.triangles + np.int32(start) for mesh, start in zip(meshes, starts, strict=True)])),
        np.repeat(levels.astype(np.int8), counts),
    )


def remove_unused(mesh: CutMesh) -> CutMesh:
    """Return a mesh without vertices that only triangles in holes have used."""
    is_used, triangles = find_used(mesh.triangles, len(mesh.ids))
    if triangles is mesh.triangles:
        return mesh
    return CutMesh(mesh.ids[is_used], mesh.positions[is_used], mesh.normals[is_used], triangles, mesh.levels)
