"""Surfaces that get a texture from photographs, as arrays in world space."""

from dataclasses import dataclass

import numpy as np

from ...core.errors import GeometryError
from ...core.geometry.mesh import TriangleMesh
from ..meshes import SourceInstance, concatenate_in_world_space


@dataclass(frozen=True)
class PhotoSurface:
    """A triangle mesh in world space and the UVs (T, 3, 2) float32 of its corners."""

    mesh: TriangleMesh
    corner_uvs: np.ndarray


def read_surface(instances: list[SourceInstance]) -> PhotoSurface:
    """Return the surface of all `instances` with their active UV maps.

    Raises:
        GeometryError: one has no UV map.
    """
    corner_uvs = []
    for instance in instances:
        mesh = instance.mesh
        if not mesh.uv_map:
            raise GeometryError(f'"{instance.name}" has no UV map; unwrap it first.')
        uvs = mesh.at_corners(mesh.uv_map, np.arange(len(mesh.triangles)))
        corner_uvs.append(uvs[:, ::-1] if instance.is_mirrored else uvs)
    return PhotoSurface(concatenate_in_world_space(instances), np.concatenate(corner_uvs).astype(np.float32))
