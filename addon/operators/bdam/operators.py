"""Operators of the tool `bdam` in the scene: load a terrain, update it, let it follow the view, remove it."""

from pathlib import Path

import bpy

from ...bridge.bdam import objects as terrain_objects
from ...bridge.bdam.objects import SceneTerrain, TerrainChange
from ...core.bdam.settings import ViewSettings
from ...core.bdam.view.engine import BdamEngine
from ...core.errors import FileError
from .. import follow_handlers, properties, start_job
from ..engine_cache import cache
from ..error_reports import reports_errors
from ..file_browser import open_file_browser, remember_folder
from ..follow_tools import FollowTool
from ..following import disabled_reason
from ..long_work import poll_with_reason
from ..properties import absolute_path
from ..results import show_result
from ..view_following import ActiveTerrainOperator, FollowViewOperator, context_viewport, view_of_area
from .job import ShowJob, prepare_load, prepare_update


class FARFIELD_PG_bdam_view(bpy.types.PropertyGroup):
    """How terrains are shown, stored per scene."""

    settings_types = (ViewSettings,)
    __annotations__ = properties.build_annotations(ViewSettings, set())


class FARFIELD_OT_bdam_load(start_job.StartJob, bpy.types.Operator):
    """Load a terrain that was built before, as this view needs it"""

    bl_idname = "farfield.bdam_load"
    bl_label = "Load Large Terrain"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (ViewSettings,), "farfield_bdam_view"
    __annotations__ = start_job.setting_properties(*settings_types) | {
        "directory": bpy.props.StringProperty(
            name="Store", description="Folder of the terrain", subtype="DIR_PATH", options={"SKIP_SAVE", "PATH_SUPPORTS_BLEND_RELATIVE"}
        ),
        "filter_folder": bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"}),
        "use_relative_path": bpy.props.BoolProperty(
            name="Relative Path", description="Store the path relative to this file, so that both can be moved together", default=True
        ),
        "frame_view": bpy.props.BoolProperty(
            name="Frame Terrain",
            description="Show the whole terrain in this 3D Viewport, extend its clipping range, and outline no objects",
            default=True,
        ),
    }

    disabled_reason = staticmethod(disabled_reason)

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, for the first time next to the store that was built last."""
        store = context.scene.farfield_bdam_build.store
        return open_file_browser(self, context, folder=absolute_path(store).parent if store else None)

    def prepare(self, context: bpy.types.Context) -> ShowJob:
        """Open the store and read the view."""
        if not self.directory:
            raise FileError("No folder is given; choose the folder of a terrain.")
        remember_folder(self, context, Path(bpy.path.abspath(self.directory)))
        settings, area = self.read_settings(context)[ViewSettings], context_viewport(context)
        return prepare_load(context.scene, self.directory, settings, area, is_relative=self.use_relative_path, frame_view=self.frame_view)


class FARFIELD_OT_bdam_update(ActiveTerrainOperator, start_job.StartJob, bpy.types.Operator):
    """Show the active terrain as this view needs it, with the current settings"""

    bl_idname = "farfield.bdam_update"
    bl_label = "Update Large Terrain"
    bl_options = {"REGISTER", "UNDO"}
    terrain_type = SceneTerrain
    settings_types, panel_property = (ViewSettings,), "farfield_bdam_view"
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> ShowJob:
        """Read the settings, the view and the active terrain."""
        terrain = self.active_terrain(context)
        settings = self.read_settings(context)[ViewSettings]
        return prepare_update(terrain, settings, view_of_area(context.scene, context_viewport(context)))


class FARFIELD_OT_bdam_follow_view(FollowViewOperator, bpy.types.Operator):
    """Keep the active terrain as detailed as this view needs it, or the active camera if the view looks through it. Press again to stop"""

    bl_idname = "farfield.bdam_follow_view"
    bl_label = "Follow View with Large Terrain"
    terrain_type = SceneTerrain


class FARFIELD_OT_bdam_remove(ActiveTerrainOperator, bpy.types.Operator):
    """Remove the active terrain from the scene. Its store stays as it is"""

    bl_idname = "farfield.bdam_remove"
    bl_label = "Remove Large Terrain"
    bl_options = {"REGISTER", "UNDO"}
    terrain_type = SceneTerrain

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain that can be removed is active."""
        return poll_with_reason(cls, cls.disabled_reason(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the terrain with its meshes, materials and images."""
        terrain = self.active_terrain(context)
        name = terrain.name
        terrain_objects.remove(terrain)
        cache.evict_missing()
        show_result(self, context.scene, f'"{name}" was removed.')
        return {"FINISHED"}


class BdamFollowTool(FollowTool):
    """The tool `bdam` among those whose terrains follow. Its engines take viewers in the local frame of the store."""

    terrain_type = SceneTerrain

    def create_engine(self, terrain: SceneTerrain) -> BdamEngine:
        """Create an engine for a terrain.

        Raises:
            SettingsError, FileError: the settings or the store cannot be read.
        """
        return BdamEngine(terrain.folder, terrain.settings)

    def is_engine_of(self, engine: BdamEngine, terrain: SceneTerrain) -> bool:
        """Return whether an engine has the current settings and the current store of its terrain."""
        return engine.settings == terrain.settings and engine.folder == terrain.folder

    def start_change(self, terrain: SceneTerrain, engine: BdamEngine) -> TerrainChange:
        """Return the change of a new move."""
        return TerrainChange(terrain, engine)


TOOL = BdamFollowTool()
CLASSES = (
    FARFIELD_PG_bdam_view,
    FARFIELD_OT_bdam_load,
    FARFIELD_OT_bdam_update,
    FARFIELD_OT_bdam_follow_view,
    FARFIELD_OT_bdam_remove,
)


register_settings, unregister_settings = properties.scene_settings_factory("farfield_bdam_view", FARFIELD_PG_bdam_view, CLASSES)


def _read_store_path(root: bpy.types.Object) -> str:
    """Return the custom property of the store: unlike it, a property that is registered may be a path relative to the .blend file."""
    return str(root.get(terrain_objects.STORE_KEY, ""))


def _write_store_path(root: bpy.types.Object, path: str) -> None:
    root[terrain_objects.STORE_KEY] = path


def register() -> None:
    """Register the classes, add the settings to scenes, and let terrains follow."""
    register_settings()
    bpy.types.Object.farfield_bdam_store_path = bpy.props.StringProperty(
        name="Store",
        description="Folder of the store of this terrain",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        get=_read_store_path,
        set=_write_store_path,
    )
    follow_handlers.register_tool(TOOL)


def unregister() -> None:
    """Stop following, remove the settings from scenes, and unregister the classes."""
    follow_handlers.unregister_tool(TOOL)
    del bpy.types.Object.farfield_bdam_store_path
    unregister_settings()
