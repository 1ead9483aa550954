"""Surfaces that get a texture from photographs, as arrays in world space."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.errors import GeometryError
from ...core.geometry.cameras import CameraProjection
from ...core.geometry.lenses import PhotoCamera
from ...core.geometry.mesh import TriangleMesh
from ...core.photos.texels.pages import PageLayout
from ...core.photos.texels.texel_map import TexelMap
from ..geometry.mesh_arrays import read_loop_vertices, read_values
from ..geometry.meshes import SourceInstance, concatenate_in_world_space

OVERLAP_SIZE = 256  # texels per side in which the UV maps of objects are compared
MAX_OVERLAP = 0.02  # fraction of the texels of an object that others may cover: islands may touch
NEAR_FRACTION = 1e-4  # nearest depth relative to the farthest


@dataclass(frozen=True)
class PhotoSurface:
    """A triangle mesh in world space and the UVs (T, 3, 2) float32 of its corners."""

    mesh: TriangleMesh
    corner_uvs: np.ndarray


def read_surface(instances: list[SourceInstance], new_uvs: Mapping[int, np.ndarray] | None = None) -> PhotoSurface:
    """Return the surface of all `instances` with the UV maps that render.

    new_uvs: UVs (T, 3, 2) that replace the UV map of an object with this session UID, for the triangles of its mesh.

    Raises:
        GeometryError: there are none, or one has no UV map.
    """
    mesh, corner_uvs = concatenate_in_world_space(instances), []
    for instance in instances:
        uvs = (new_uvs or {}).get(instance.object_uid)
        if uvs is None:
            own = instance.mesh
            if not own.uv_map:
                raise GeometryError(f'"{instance.name}" has no UV map; unwrap it first.')
            uvs = own.at_corners(own.uv_map, np.arange(len(own.triangles)))
        corner_uvs.append(uvs[:, ::-1] if instance.is_mirrored else uvs)
    return PhotoSurface(mesh, np.concatenate(corner_uvs).astype(np.float32))


def split_layout(instances: list[SourceInstance], layout: PageLayout) -> Iterator[tuple[SourceInstance, np.ndarray, np.ndarray]]:
    """Yield each instance with the UVs (T, 3, 2) and pages (T,) of its triangles."""
    start = 0
    for instance in instances:
        rows = slice(start, start + len(instance.mesh.triangles))
        yield instance, layout.corner_uvs[rows], layout.pages[rows]
        start = rows.stop


def check_separate_uvs(instances: list[SourceInstance], layout: PageLayout) -> None:
    """Check that UV maps of different `instances`, whose triangles are on common pages, cover different texels. Raises GeometryError if two
    of them overlap."""
    all_owners = np.full(max(len(layout.tiles), 1) * OVERLAP_SIZE**2, -1)
    for index, (instance, corner_uvs, pages) in enumerate(split_layout(instances, layout) if len(instances) > 1 else ()):
        covered = TexelMap(corner_uvs, OVERLAP_SIZE, pages).triangles >= 0
        owners = all_owners[: len(covered)]
        taken = covered & (owners >= 0)
        if np.count_nonzero(taken) > MAX_OVERLAP * np.count_nonzero(covered):
            other = instances[int(np.bincount(owners[taken]).argmax())]
            raise GeometryError(
                f'The UV maps of "{other.name}" and "{instance.name}" overlap, but they get one texture; '
                "pack their islands together, or select one object at a time."
            )
        owners[covered] = index


def select_faces(mesh: bpy.types.Mesh, polygons: np.ndarray) -> None:
    """Select the faces (N,) of a mesh and no others, as Edit Mode will show them.

    Edges stay as they are: Blender 5.0 crashes when their selection is set while all have the same value. Edit Mode derives it, unless it
    selects edges only.
    """
    is_selected = np.zeros(len(mesh.polygons), bool)
    is_selected[polygons] = True
    loop_counts = read_values(mesh.polygons, "loop_total", dtype=np.int32)
    vertices = np.zeros(len(mesh.vertices), bool)
    vertices[read_loop_vertices(mesh)[np.repeat(is_selected, loop_counts)]] = True
    mesh.polygons.foreach_set("select", is_selected)
    mesh.vertices.foreach_set("select", vertices)
    mesh.update()


def to_projection(camera: PhotoCamera, points: np.ndarray) -> CameraProjection | None:
    """Return the projection of a camera without its distortion, with depths from the nearest to the farthest of `points` (N, 3); None if
    all of them are behind it."""
    depths = points @ camera.rotation[2] + camera.translation[2]
    if not (depths > 0.0).any():
        return None
    far = 1.01 * float(depths.max())
    near = max(0.99 * float(depths[depths > 0.0].min()), NEAR_FRACTION * far)
    (width, height), (focal_x, focal_y), (center_x, center_y) = camera.lens.size, camera.lens.focal, camera.lens.center
    projection = np.array([
        [2.0 * focal_x / width, 0.0, 2.0 * center_x / width - 1.0, 0.0],
        [0.0, -2.0 * focal_y / height, 1.0 - 2.0 * center_y / height, 0.0],
        [0.0, 0.0, (far + near) / (far - near), -2.0 * far * near / (far - near)],
        [0.0, 0.0, 1.0, 0.0],
    ])  # fmt: skip
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = camera.rotation, camera.translation
    return CameraProjection(projection @ view, camera.lens.size)
