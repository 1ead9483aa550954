"""The operator *Drop to Ground of Large Terrain*."""

from contextlib import AbstractContextManager

import bpy
import numpy as np

from ...bridge.bdam import freezing
from ...bridge.bdam.objects import SceneTerrain
from ...core.bdam.ground.surfaces import StoreSurface
from ...core.bdam.settings import GroundSettings
from ...core.bdam.store.terrain_store import TerrainStore
from ...core.errors import GeometryError
from ...core.geometry.surfaces import MeshSurface, Surface
from .. import properties, start_job
from ..placing import DropOperator


class FARFIELD_OT_bdam_drop(DropOperator, bpy.types.Operator):
    """Put the selected objects, or the points of the selected meshes and point clouds, on the terrain"""

    bl_idname = "farfield.bdam_drop"
    bl_label = "Drop to Ground of Large Terrain"
    terrain_type = SceneTerrain
    settings_types, panel_property = (GroundSettings,), "farfield_bdam_ground"
    __annotations__ = start_job.setting_properties(*settings_types)

    @staticmethod
    def open_surface(terrain: SceneTerrain, settings: GroundSettings, _points: np.ndarray) -> tuple[Surface, AbstractContextManager | None]:
        """Return the tiles that are shown, or the store; see `DropOperator.open_surface`."""
        if settings.surface == "shown":
            tiles = freezing.read_tiles(terrain)
            if not tiles:
                raise GeometryError(f'The terrain "{terrain.name}" shows nothing; press Update first.')
            return MeshSurface([(tile.vertices.astype(np.float64) + tile.location, tile.triangles) for tile in tiles]), None
        store = TerrainStore(terrain.folder, terrain.settings.curvature)
        return StoreSurface(store, terrain.settings.exaggeration), store


class FARFIELD_PG_bdam_ground(bpy.types.PropertyGroup):
    """Settings of *Drop to Ground* in the panel, stored per scene."""

    __annotations__ = properties.build_annotations(GroundSettings, set())


CLASSES = (FARFIELD_PG_bdam_ground, FARFIELD_OT_bdam_drop)
register, unregister = properties.scene_settings_factory("farfield_bdam_ground", FARFIELD_PG_bdam_ground, CLASSES)
