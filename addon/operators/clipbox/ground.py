"""The operator *Drop to Ground of Clip-Box Terrain*."""

from contextlib import AbstractContextManager

import bpy
import numpy as np

from ...bridge.clipbox.objects import SceneTerrain, read_blocks
from ...core.clipbox.settings import GroundSettings
from ...core.errors import GeometryError
from ...core.geometry.surfaces import SolidSurface, Surface
from .. import properties, start_job
from ..placing import DropOperator


class FARFIELD_OT_clipbox_drop(DropOperator, bpy.types.Operator):
    """Put the selected objects, or the points of the selected meshes and point clouds, on the ground of the terrain as it is shown: below
    them, also in caves, or above them if they are in the rock"""

    bl_idname = "farfield.clipbox_drop"
    bl_label = "Drop to Ground of Clip-Box Terrain"
    terrain_type = SceneTerrain
    settings_types, panel_property = (GroundSettings,), "farfield_clipbox_ground"
    __annotations__ = start_job.setting_properties(*settings_types)

    @staticmethod
    def open_surface(terrain: SceneTerrain, _settings: GroundSettings, points: np.ndarray) -> tuple[Surface, AbstractContextManager | None]:
        """Return the blocks above and below the points; see `DropOperator.open_surface`."""
        if not terrain.blocks():
            raise GeometryError(f'The terrain "{terrain.name}" shows nothing; press Update first.')
        return SolidSurface(read_blocks(terrain, points)), None


class FARFIELD_PG_clipbox_ground(bpy.types.PropertyGroup):
    """Settings of *Drop to Ground* in the panel, stored per scene."""

    __annotations__ = properties.build_annotations(GroundSettings, set())


CLASSES = (FARFIELD_PG_clipbox_ground, FARFIELD_OT_clipbox_drop)
register, unregister = properties.scene_settings_factory("farfield_clipbox_ground", FARFIELD_PG_clipbox_ground, CLASSES)
