"""Operators of the tool `clipbox`: create and update a terrain, and let it follow the view."""

import bpy
import mathutils
import numpy as np

from ...bridge.clipbox import objects as terrain_objects
from ...bridge.clipbox import sources
from ...bridge.clipbox.edits import read_edits
from ...bridge.clipbox.objects import PendingBlocks, SceneTerrain
from ...bridge.viewers import extend_clipping
from ...core.clipbox.blocks import BlockMesh
from ...core.clipbox.engine import BlockKey, TerrainEngine, Update
from ...core.clipbox.settings import ClipboxSettings
from ...core.clipbox.terrains.edits import Edits
from ...core.geometry.viewers import Viewer
from .. import follow_handlers, properties, start_job
from ..follow_tools import FollowTool
from ..following import disabled_reason
from ..view_following import ActiveTerrainOperator, FollowViewOperator, context_viewport, view_of_area
from .job import TerrainJob, prepare

VIEW_DISTANCE = 1.0  # from the eye to the pivot, relative to the innermost box
ROTATION = mathutils.Euler((1.25, 0.0, 0.0))  # to the north, and a little down


class FARFIELD_PG_clipbox(bpy.types.PropertyGroup):
    """Settings of the panel *Clip-Box Terrain*, stored per scene."""

    settings_types = (ClipboxSettings,)
    __annotations__ = properties.build_annotations(ClipboxSettings, set())


class FARFIELD_OT_clipbox_create(start_job.StartJob, bpy.types.Operator):
    """Create a terrain in nested boxes around the current view, or around the active camera if the view looks through it"""

    bl_idname = "farfield.clipbox_create"
    bl_label = "Create Clip-Box Terrain"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (ClipboxSettings,), "farfield_clipbox"
    __annotations__ = start_job.setting_properties(*settings_types) | {
        "frame_view": bpy.props.BoolProperty(
            name="Frame Terrain",
            description="Look over the terrain in this 3D Viewport, from above the ground if the view is in it; extend its clipping range, "
            "and outline no objects",
            default=True,
        )
    }

    disabled_reason = staticmethod(disabled_reason)

    def prepare(self, context: bpy.types.Context) -> TerrainJob:
        """Read the settings and the viewer position."""
        job, area = prepare(self.read_settings(context)[ClipboxSettings], viewer_position(context)), context_viewport(context)
        if self.frame_view and area is not None:
            job.viewer = frame_terrain(area.spaces.active, job)
        return job


class FARFIELD_OT_clipbox_update(ActiveTerrainOperator, start_job.StartJob, bpy.types.Operator):
    """Rebuild the active terrain with the current settings"""

    bl_idname = "farfield.clipbox_update"
    bl_label = "Update Terrain"
    bl_options = {"REGISTER", "UNDO"}
    terrain_type = SceneTerrain
    settings_types, panel_property = (ClipboxSettings,), "farfield_clipbox"
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> TerrainJob:
        """Read the settings and the active terrain."""
        terrain = self.active_terrain(context)
        return prepare(self.read_settings(context)[ClipboxSettings], terrain.viewer, terrain)


class FARFIELD_OT_clipbox_follow_view(FollowViewOperator, bpy.types.Operator):
    """Keep the active terrain centered on this view, or on the active camera if the view looks through it. Press again to stop"""

    bl_idname = "farfield.clipbox_follow_view"
    bl_label = "Follow View with Terrain"
    terrain_type = SceneTerrain


def viewer_position(context: bpy.types.Context) -> np.ndarray:
    """Return the position (3,) float64 of the viewer in world space: of the 3D Viewport under the pointer, or of the first one."""
    return view_of_area(context.scene, context_viewport(context)).position


def frame_terrain(space: bpy.types.SpaceView3D, job: TerrainJob) -> np.ndarray:
    """Let a 3D Viewport show a new terrain: look down from its position, or from above if that is in the ground. A view through the camera
    only gets a larger clipping range. Returns the position (3,) of the viewer."""
    settings, region = job.settings, space.region_3d
    extend_clipping(space, settings.extent)
    if region.view_perspective == "CAMERA":
        return job.viewer
    position = job.engine.find_clearing(job.viewer)
    rotation, distance = ROTATION.to_quaternion(), VIEW_DISTANCE * settings.voxel_size * settings.resolution
    region.view_perspective, region.view_rotation, region.view_distance = "PERSP", rotation, distance
    region.view_location = (position - distance * np.array(rotation @ mathutils.Vector((0.0, 0.0, 1.0)))).tolist()
    region.update()
    return position


class TerrainChange:
    """One move of one terrain."""

    def __init__(self, terrain: SceneTerrain, engine: TerrainEngine) -> None:
        self._terrain = terrain
        self._pending = PendingBlocks(terrain.origin, engine.settings)

    def fill(self, key: BlockKey, block: BlockMesh) -> tuple[()]:
        """Fill the mesh of a block, at once: blocks are small."""
        self._pending.fill(key, block)
        return ()

    def show(self, update: Update) -> tuple[()]:
        """Show all meshes."""
        terrain_objects.show_meshes(self._terrain, self._pending.meshes, update, self._terrain.material)
        return ()


def _edits_of(terrain: SceneTerrain) -> Edits:
    """Return the edits of a terrain, in the scene that it is in."""
    return read_edits(bpy.context.scene, terrain.settings.edit_blend, terrain)


class ClipboxFollowTool(FollowTool):
    """The tool `clipbox` among those whose terrains follow. Its engines take the terrain position (3,) of the viewer."""

    terrain_type = SceneTerrain

    def create_engine(self, terrain: SceneTerrain) -> TerrainEngine:
        """Create an engine for a terrain.

        Raises:
            SettingsError, FileError: the settings, the formula or the source file cannot be read.
        """
        return sources.create_engine(terrain.settings, edits=_edits_of(terrain))

    def is_engine_of(self, engine: TerrainEngine, terrain: SceneTerrain) -> bool:
        """Return whether an engine has the current settings of its terrain and the solids that are now added and subtracted."""
        return engine.settings == sources.resolve_paths(terrain.settings) and engine.edits == _edits_of(terrain)

    def to_terrain(self, terrain: SceneTerrain, viewer: Viewer) -> np.ndarray:
        """Return the terrain position (3,) float64 of a viewer in world space."""
        return terrain.viewer_position(viewer.matrix)

    def is_shown_at(self, terrain: SceneTerrain, viewer: np.ndarray) -> bool:
        """Return whether the boxes already lie as they would around `viewer` (3,)."""
        return terrain.is_complete and TerrainEngine.has_same_layout(terrain.settings, terrain.viewer, viewer)

    def start_change(self, terrain: SceneTerrain, engine: TerrainEngine) -> TerrainChange:
        """Return the change of a new move."""
        return TerrainChange(terrain, engine)


TOOL = ClipboxFollowTool()


CLASSES = (FARFIELD_PG_clipbox, FARFIELD_OT_clipbox_create, FARFIELD_OT_clipbox_update, FARFIELD_OT_clipbox_follow_view)


register_settings, unregister_settings = properties.scene_settings_factory("farfield_clipbox", FARFIELD_PG_clipbox, CLASSES)


def register() -> None:
    """Register the classes, add the settings to scenes, and let terrains follow."""
    register_settings()
    follow_handlers.register_tool(TOOL)


def unregister() -> None:
    """Stop following, remove the settings from scenes, and unregister the classes."""
    follow_handlers.unregister_tool(TOOL)
    unregister_settings()
