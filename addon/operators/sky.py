"""The operator *Add Sky and Haze*, for the landscapes of both terrain tools.

The scene keeps the settings of the last sky. Presets of landscapes set them, so that each has a light that suits it.
"""

import bpy
import numpy as np

from ..bridge import sky
from ..bridge.objects import world_matrix
from ..bridge.scatter import find_materials
from ..bridge.terrain_roots import TerrainRoot
from ..core.geometry.transforms import transform_points
from ..core.settings import describe
from ..core.sky import SkySettings
from . import follow_tools, properties, start_job
from .error_reports import report_message, reports_errors


class FARFIELD_PG_clipbox_sky(bpy.types.PropertyGroup):
    """Settings of the last sky, or of the next one after a preset, stored per scene."""

    settings_types = (SkySettings,)
    __annotations__ = properties.build_annotations(SkySettings, set())


class FARFIELD_OT_add_sky(bpy.types.Operator):
    """Give the scene a World with sky and a Sun light, and the terrains in it haze, in the light of the last sky or of the preset. Sky and
    Sun of this button change; other lights and Worlds stay in the file"""

    bl_idname = "farfield.add_sky"
    bl_label = "Add Sky and Haze"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = start_job.setting_properties(SkySettings)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the sky and the Sun, and haze to the materials of terrains."""
        scene, last = context.scene, context.scene.farfield_clipbox_sky
        properties.fill_unset(SkySettings, self, last)
        settings = properties.read(SkySettings, self)
        for item in describe(SkySettings):
            setattr(last, item.name, getattr(self, item.name))
        replaced = sky.find_users_world(scene)
        sky.add_sky(scene, settings)
        terrains = [terrain for tool in follow_tools.registered.values() for terrain in tool.terrain_type.in_scene(scene)]
        for terrain in terrains:
            if not terrain.read_only_reason:
                add_haze(terrain, settings)
        note = f' The World "{replaced.name}" stays in the file.' if replaced is not None else ""
        report_message(self, f"Added sky and Sun{', and haze to the ground' if terrains else ''}.{note}")
        return {"FINISHED"}


def add_haze(terrain: TerrainRoot, settings: SkySettings) -> None:
    """Add haze to the materials of a terrain, as dense as its size asks for."""
    ground = terrain.ground_objects()
    if not ground:
        return
    corners = np.concatenate([transform_points(world_matrix(item), item.bound_box) for item in ground])
    low, high = corners.min(axis=0), corners.max(axis=0)
    materials = [material for item in ground for material in item.data.materials if material is not None]
    sky.add_haze([*materials, *find_materials(terrain)], settings, float((high - low)[:2].max()), float(low[2]))


CLASSES = (FARFIELD_PG_clipbox_sky, FARFIELD_OT_add_sky)
register, unregister = properties.scene_settings_factory("farfield_clipbox_sky", FARFIELD_PG_clipbox_sky, CLASSES)
