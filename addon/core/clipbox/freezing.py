"""Terrain as plain meshes: one for all boxes or one a box, with UVs, and a collider of few triangles."""

from dataclasses import dataclass

import numpy as np

from ..mesh import scaled_normals
from ..progress import Progress, Steps, scaled
from ..simplification import simplified
from .settings import ClipboxSettings, FreezeSettings
from .terrain import Terrain, Welded, welded

TILE = 16.0  # voxels: how far the unit square of the UVs reaches
LEAST_TRIANGLES = 4  # of a collider


@dataclass(frozen=True)
class Frozen:
    """One mesh: its name, its surface, and the UVs (T, 3, 2) float32 of its corners, None for a collider."""

    name: str
    surface: Welded
    uvs: np.ndarray | None


def freeze(engine: Terrain, viewer: np.ndarray, chosen: FreezeSettings) -> Steps[list[Frozen]]:
    """The meshes of a terrain about a viewer at (3,) scene units; the collider is the last.

    engine: a terrain that has not moved yet, closed or not as `chosen`.

    Raises:
        GeometryError: when there is no ground within the boxes.
    """
    update = yield from scaled(engine.move(viewer), 0.0, 0.6)
    yield Progress(0.6, "Joining blocks")
    united = welded(list(update.meshes.values()))
    settings = engine.settings
    parts = [("Ground", united)]
    if chosen.per_box:
        levels = sorted({level for level, _ in update.meshes})
        parts = [(f"Box {level + 1}", welded([mesh for key, mesh in update.meshes.items() if key[0] == level])) for level in levels]
    made = []
    for name, surface in parts:
        yield Progress(0.75, "Laying out")
        made.append(Frozen(name, surface, box_mapped(surface, TILE * settings.voxel)))
    if chosen.collider:
        yield Progress(0.85, "Simplifying the collider")
        made.append(Frozen("Collider", collider_of(united, chosen.collider_share, settings), None))
    return made


def box_mapped(surface: Welded, size: float) -> np.ndarray:
    """UVs (T, 3, 2) float32: each triangle is mapped along the axis that it faces most, `size` scene units a unit."""
    corners = surface.vertices[surface.triangles]
    axis = np.abs(scaled_normals(corners)).argmax(axis=1)
    across = np.array([(1, 2), (0, 2), (0, 1)])[axis]
    origin = np.floor(surface.vertices.min(axis=0) / size) * size  # far from the origin single precision has no digits left for it
    return (np.take_along_axis(corners - origin, across[:, None, :], axis=2) / size).astype(np.float32)


def collider_of(surface: Welded, share: float, settings: ClipboxSettings) -> Welded:
    """A surface with about `share` of the triangles of another, by collapses of least quadric error."""
    centre = surface.vertices.mean(axis=0)
    places = ((surface.vertices - centre) / settings.voxel).astype(np.float32)
    target = max(int(share * len(surface.triangles)), LEAST_TRIANGLES)
    vertices, triangles = simplified(places, surface.triangles, target)
    return Welded(vertices * settings.voxel + centre, None, triangles)
