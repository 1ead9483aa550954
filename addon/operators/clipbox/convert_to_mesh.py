"""The operator *Convert Terrain to Mesh*."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.clipbox import objects as terrain_objects
from ...bridge.clipbox import sources
from ...bridge.clipbox.edits import read_edits
from ...bridge.clipbox.objects import SceneTerrain
from ...bridge.scatter import move_scatter
from ...core.clipbox.engine import TerrainEngine
from ...core.clipbox.settings import ConvertSettings
from ...core.clipbox.to_mesh import ConvertedMesh, convert_to_meshes
from ...core.errors import GeometryError, SettingsError
from ...core.jobs.progress import Progress, Steps
from .. import properties, start_job
from ..engine_cache import cache
from ..view_following import ActiveTerrainOperator


@dataclass
class ConvertJob:
    """Converts a terrain to meshes.

    Attributes:
        terrain: the terrain.
        engine: computes the terrain again.
        viewer: (3,) float64, terrain position.
        settings: settings of the conversion.
        object_names: afterwards the names of the new objects.
    """

    core_fraction = 0.95

    terrain: SceneTerrain
    engine: TerrainEngine
    viewer: np.ndarray
    settings: ConvertSettings
    object_names: tuple[str, ...] = ()

    def core_steps(self) -> Steps[list[ConvertedMesh]]:
        """Compute the meshes."""
        return convert_to_meshes(self.engine, self.viewer, self.settings)

    def scene_steps(self, core_result: list[ConvertedMesh]) -> Steps[str]:
        """Create the objects, and remove the terrain unless it is to be kept. Returns the message for the user.

        Raises:
            GeometryError: the terrain was removed during the conversion.
        """
        yield Progress(0.5, "Creating objects")
        if self.terrain.root is None:
            raise GeometryError(f'The terrain "{self.terrain.name}" was removed during the conversion.')
        self.object_names = terrain_objects.add_converted_meshes(bpy.context.scene, self.terrain, core_result)
        if not self.settings.keep_terrain:
            move_scatter(self.terrain, bpy.data.objects[self.object_names[0]].users_collection[0])
            terrain_objects.remove(self.terrain)
            cache.evict_missing()
        triangles = sum(len(part.mesh.triangles) for part in core_result)
        meshes = f"{len(core_result)} mesh{'' if len(core_result) == 1 else 'es'}"
        return f'Converted "{self.terrain.name}" to {meshes} with {triangles:,} triangles.'


class FARFIELD_OT_clipbox_convert_to_mesh(ActiveTerrainOperator, start_job.StartJob, bpy.types.Operator):
    """Convert the active terrain to regular mesh objects that do not need Farfield"""

    bl_idname = "farfield.clipbox_convert_to_mesh"
    bl_label = "Convert Terrain to Mesh"
    bl_options = {"REGISTER", "UNDO"}
    terrain_type, changes_terrain = SceneTerrain, False
    settings_types, panel_property = (ConvertSettings,), "farfield_clipbox_convert"
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> ConvertJob:
        """Prepare the conversion of the active terrain."""
        return prepare(self.active_terrain(context), self.read_settings(context)[ConvertSettings])


def prepare(terrain: SceneTerrain, settings: ConvertSettings) -> ConvertJob:
    """Return the job that converts a terrain in its current position.

    Raises:
        SettingsError, FileError: the terrain's settings, position, formula or source file cannot be read, or it is linked and is to be
            removed.
    """
    if terrain.read_only_reason and not settings.keep_terrain:
        raise SettingsError(f"{terrain.read_only_reason}, or enable Keep Terrain.", ("keep_terrain",))
    _ = terrain.origin  # raises SettingsError before anything is created
    edits = read_edits(bpy.context.scene, terrain.settings.edit_blend, terrain)
    engine = sources.create_engine(terrain.settings, settings.closed, terrain.root.library, edits)
    return ConvertJob(terrain, engine, terrain.viewer, settings)


class FARFIELD_PG_clipbox_convert(bpy.types.PropertyGroup):
    """Settings of *Convert to Mesh* in the panel, stored per scene."""

    __annotations__ = properties.build_annotations(ConvertSettings, set())


CLASSES = (FARFIELD_PG_clipbox_convert, FARFIELD_OT_clipbox_convert_to_mesh)
register, unregister = properties.scene_settings_factory("farfield_clipbox_convert", FARFIELD_PG_clipbox_convert, CLASSES)
