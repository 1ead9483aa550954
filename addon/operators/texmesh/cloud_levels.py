"""Billboard clouds as last levels: built and captured as by the tool `billboards`, with materials that every program shows."""

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.billboards.capture import capture_textures
from ...bridge.billboards.clouds import create_cloud
from ...bridge.billboards.exports import create_plain_mesh
from ...bridge.billboards.level_maps import LevelTextures
from ...bridge.blender import remove_unused_data
from ...bridge.geometry.joined_meshes import find_frame
from ...bridge.geometry.mesh_arrays import read_positions
from ...bridge.geometry.meshes import Source, read_source
from ...bridge.imaging.images import check_images, find_images
from ...bridge.lod_sets import KIND
from ...bridge.objects import find_by_uid, temporarily_visible
from ...bridge.texmesh.level_sets import IMAGE, NewLevel, Placement
from ...bridge.texmesh.sources import TexturedSource
from ...core.billboards.build import build_cloud
from ...core.billboards.cloud import Cloud
from ...core.billboards.settings import BillboardSettings
from ...core.geometry.transforms import is_invertible, transform_points
from ...core.jobs.progress import Steps
from ...core.texmesh.settings import SceneSettings

MIN_RATIO = 1.25  # between the pixel sizes at which the cloud and the level before it show


@dataclass(frozen=True, eq=False)
class CloudSource:
    """What a cloud is made of. frame: (4, 4), from the space of the levels to the world."""

    source: Source
    frame: np.ndarray
    settings: BillboardSettings

    def build(self) -> Steps[Cloud]:
        """Find the quads."""
        return build_cloud(self.source.geometry, self.settings, self.source.name)

    def capture(self, cloud: Cloud) -> Steps[list[LevelTextures]]:
        """Render their images."""
        return capture_textures(self.source, cloud, self.settings)

    def create_level(self, cloud: Cloud, textures: list[LevelTextures], pixel_size: float, scene: bpy.types.Scene) -> NewLevel:
        """Create the level that follows one that shows from `pixel_size` on, without a switch distance."""
        collection = create_cloud(cloud, textures, self.source, scene.collection)
        (item,) = collection.objects
        mesh = create_plain_mesh(item)
        vertices = transform_points(np.linalg.inv(self.frame), read_positions(mesh) + self.source.origin)
        mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
        mesh.name = f"{self.source.name} Cloud"
        images = find_images(mesh.materials)
        for image in images:
            image[KIND] = IMAGE
        _remove(collection, images)
        error = cloud.levels[0].error / float(np.cbrt(abs(np.linalg.det(self.frame[:3, :3]))))
        return NewLevel(mesh, max(error, MIN_RATIO * pixel_size), error, 0.0)


def _remove(collection: bpy.types.Collection, kept: Sequence[bpy.types.Image]) -> None:
    """Remove a cloud with its data, except for the images in `kept`."""
    meshes = [item.data for item in collection.objects]
    materials = [material for mesh in meshes for material in mesh.materials]
    images = [image for image in find_images(materials) if image not in kept]
    bpy.data.batch_remove([*collection.objects, *meshes])
    remove_unused_data(materials, images)
    bpy.data.collections.remove(collection)


def read_cloud_sources(
    context: bpy.types.Context, sources: Sequence[TexturedSource], placements: Sequence[Sequence[Placement]], settings: SceneSettings
) -> tuple[list[CloudSource | None], list[str]]:
    """Return what clouds are made of if they are wanted, None for meshes without, and names of these with the reason.

    Raises:
        FileError: an image file of a material is missing.
    """
    found: list[CloudSource | None] = []
    skipped = []
    for source, (placement, *_) in zip(sources, placements, strict=True):
        item = find_by_uid(bpy.data.objects, placement.object_uid)
        frame = find_frame(np.array(item.matrix_world))
        reason = "" if source.rig is None else "it is deformed"
        reason = "it is an instance" if placement.matrix is not None else reason
        reason = reason or ("" if is_invertible(frame) else "it has a scale of 0")
        is_made = settings.billboard_cloud and not reason
        found.append(_read(context, item, frame, settings.cloud_quads) if is_made else None)
        if settings.billboard_cloud and reason:
            skipped.append(f"the billboard cloud of {source.name} ({reason})")
    return found, skipped


def _read(context: bpy.types.Context, item: bpy.types.Object, frame: np.ndarray, quads: int) -> CloudSource:
    with temporarily_visible(context, [item]) as depsgraph:
        source = read_source([item], depsgraph)
    check_images(source)
    return CloudSource(source, frame, BillboardSettings(levels=1, quads=quads))
