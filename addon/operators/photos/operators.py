"""Operator of the tool `photos` that merges photographs into a texture."""

from collections.abc import Callable
from functools import partial

import bpy

from ...core.photos.settings import PhotosSettings
from .. import long_work, properties, start_job
from ..view_following import show_textures, viewport_address
from .job import MergeJob, prepare
from .sources import disabled_reason

MAPS = {"name": "Maps", "description": "Also create images of confidence, source photograph and holes"}


class FARFIELD_PG_photos(bpy.types.PropertyGroup):
    """Settings of the panel *Photo Texture*, stored per scene."""

    settings_types = (PhotosSettings,)
    __annotations__ = properties.build_annotations(PhotosSettings, set()) | {"maps": bpy.props.BoolProperty(**MAPS)}


class FARFIELD_OT_photos_merge(start_job.StartJob, bpy.types.Operator):
    """Merge photographs into one texture for the selected meshes, and give them a material with it. The photographs are the background
    images of the selected cameras, of those below selected Empties, or otherwise of all visible cameras"""

    bl_idname = "farfield.photos_merge"
    bl_label = "Merge Photographs into Texture"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (PhotosSettings,), "farfield_photos"
    __annotations__ = start_job.setting_properties(*settings_types) | {"maps": bpy.props.BoolProperty(**MAPS, options={"SKIP_SAVE"})}

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why nothing can be merged now, or an empty string."""
        return long_work.running_job_message() or disabled_reason(context)

    def prepare(self, context: bpy.types.Context) -> MergeJob:
        """Read meshes and cameras."""
        settings = self.read_settings(context)[PhotosSettings]
        if not self.properties.is_property_set("maps"):
            self.maps = context.scene.farfield_photos.maps
        return prepare(context, settings, has_maps=self.maps)

    def prepare_follow_up(self, context: bpy.types.Context) -> Callable[[], None]:
        """Return what lets the Solid view show the texture."""
        return partial(show_textures, viewport_address(context))


CLASSES = (FARFIELD_PG_photos, FARFIELD_OT_photos_merge)
register, unregister = properties.scene_settings_factory("farfield_photos", FARFIELD_PG_photos, CLASSES)
