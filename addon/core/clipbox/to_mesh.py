"""Conversion of terrain to meshes with UVs, one for all boxes or one per box, and a collider with few triangles."""

from dataclasses import dataclass

import numpy as np

from ..geometry.collapses import quadric_decimation
from ..geometry.mesh import scaled_normals
from ..jobs.progress import Progress, Steps, subprogress
from .engine import TerrainEngine, WeldedMesh, weld
from .settings import ClipboxSettings, ConvertSettings

TILE_SIZE = 16.0  # voxels that one unit of the UVs spans
MIN_COLLIDER_TRIANGLES = 4


@dataclass(frozen=True)
class ConvertedMesh:
    """A named mesh, and the UVs (T, 3, 2) float32 of its corners, None for a collider."""

    name: str
    mesh: WeldedMesh
    uvs: np.ndarray | None


def convert_to_meshes(engine: TerrainEngine, viewer: np.ndarray, settings: ConvertSettings) -> Steps[list[ConvertedMesh]]:
    """Return the meshes of a terrain around a viewer at (3,) scene units; the collider is the last.

    engine: a terrain that has not moved yet, with the same `closed` as `settings`.

    Raises:
        GeometryError: the boxes contain no surface.
    """
    update = yield from subprogress(engine.move(viewer), 0.0, 0.6)
    yield Progress(0.6, "Welding blocks")
    combined = weld(list(update.meshes.values()))
    terrain = engine.settings
    parts = [("Ground", combined)]
    if settings.per_box:
        levels = sorted({level for level, _ in update.meshes})
        parts = [(f"Box {level + 1}", weld([mesh for key, mesh in update.meshes.items() if key[0] == level])) for level in levels]
    meshes = []
    for name, mesh in parts:
        yield Progress(0.75, "Computing UVs")
        meshes.append(ConvertedMesh(name, mesh, box_project(mesh, TILE_SIZE * terrain.voxel_size)))
    if settings.collider:
        yield Progress(0.85, "Simplifying the collider")
        meshes.append(ConvertedMesh("Collider", build_collider(combined, settings.collider_fraction, terrain), None))
    return meshes


def box_project(mesh: WeldedMesh, size: float) -> np.ndarray:
    """Return UVs (T, 3, 2) float32: each triangle is projected along the axis that it faces most, `size` scene units per UV unit."""
    corners = mesh.vertices[mesh.triangles]
    normal_axes = np.abs(scaled_normals(corners)).argmax(axis=1)
    uv_axes = np.array([(1, 2), (0, 2), (0, 1)])[normal_axes]
    origin = np.floor(mesh.vertices.min(axis=0) / size) * size  # keeps UVs small, which are single precision
    return (np.take_along_axis(corners - origin, uv_axes[:, None, :], axis=2) / size).astype(np.float32)


def build_collider(mesh: WeldedMesh, fraction: float, settings: ClipboxSettings) -> WeldedMesh:
    """Simplify a mesh to about `fraction` of its triangles by quadric decimation."""
    center = mesh.vertices.mean(axis=0)
    positions = ((mesh.vertices - center) / settings.voxel_size).astype(np.float32)
    target = max(int(fraction * len(mesh.triangles)), MIN_COLLIDER_TRIANGLES)
    vertices, triangles = quadric_decimation(positions, mesh.triangles, target)
    return WeldedMesh(vertices * settings.voxel_size + center, None, triangles)
