"""Operators of the tool `clipbox`: create and update a terrain, and let it follow the view."""

import bpy
import mathutils
import numpy as np

from ...bridge.clipbox.objects import terrain_of_object
from ...core.clipbox.settings import ClipboxSettings
from .. import long_work, properties, start_job
from ..error_reports import reports_errors
from . import following, handlers, view_following
from .following import MAX_TICK_SECONDS
from .job import TerrainJob, prepare


class FARFIELD_PG_clipbox(bpy.types.PropertyGroup):
    """Settings of the panel *Clip-Box Terrain*, stored per scene."""

    __annotations__ = properties.build_annotations(ClipboxSettings, set())


class FARFIELD_OT_clipbox_create(start_job.StartJob, bpy.types.Operator):
    """Create a terrain in nested boxes around the current view, or around the active camera if the view looks through it"""

    bl_idname = "farfield.clipbox_create"
    bl_label = "Create Clip-Box Terrain"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (ClipboxSettings,), "farfield_clipbox"
    __annotations__ = start_job.setting_properties(*settings_types)

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why no terrain can be created now, or an empty string."""
        return disabled_reason(context)

    def prepare(self, context: bpy.types.Context) -> TerrainJob:
        """Read the settings and the viewer position."""
        return prepare(*self.read_settings(context), viewer_position(context))


class FARFIELD_OT_clipbox_update(start_job.StartJob, bpy.types.Operator):
    """Rebuild the active terrain with the current settings"""

    bl_idname = "farfield.clipbox_update"
    bl_label = "Update Terrain"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (ClipboxSettings,), "farfield_clipbox"
    __annotations__ = start_job.setting_properties(*settings_types)

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why no terrain can be updated now, or an empty string."""
        return disabled_reason(context) or disabled_reason_of_active(context)

    def prepare(self, context: bpy.types.Context) -> TerrainJob:
        """Read the settings and the active terrain."""
        terrain = terrain_of_object(context.active_object)
        return prepare(*self.read_settings(context), terrain.viewer, terrain)


class FARFIELD_OT_clipbox_follow_view(bpy.types.Operator):
    """Keep the active terrain centered on this view, or on the active camera if the view looks through it. Press again to stop"""

    bl_idname = "farfield.clipbox_follow_view"
    bl_label = "Follow View with Terrain"
    bl_options = {"REGISTER"}
    budget: bpy.props.FloatProperty(
        name="Budget",
        description="Maximum time per update on Blender's main thread, in milliseconds",
        default=1000.0 * MAX_TICK_SECONDS,
        min=1.0,
        max=100.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain follows the view, or a terrain that can is active and nothing else runs."""
        if view_following.current.terrain is not None:
            return True
        return long_work.poll_with_reason(cls, disabled_reason(context) or disabled_reason_of_active(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: recenter the terrain once."""
        terrain = view_following.current.terrain or terrain_of_object(context.active_object)
        following.recenter(terrain, terrain.viewer_position(context_viewer_matrix(context)))
        return {"FINISHED"}

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start following, or stop. Everything that was shown until then is one undo step."""
        if context.window is None:
            return self.execute(context)
        if view_following.current.terrain is None:
            view_following.current.start(terrain_of_object(context.active_object), context.area, self.budget / 1000.0)
        elif view_following.current.stop():
            bpy.ops.ed.undo_push(message=self.bl_label)
        long_work.redraw_sidebars(context.window_manager)
        return {"FINISHED"}


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why no terrain can be created now, or an empty string."""
    if context.mode != "OBJECT":
        return "Switch to Object Mode"
    if not context.scene.is_editable:
        return "The scene is linked from another file"
    is_following = bool(following.running())
    return long_work.running_job_message() or ("A terrain is following the view; press Stop Following first" if is_following else "")


def disabled_reason_of_active(context: bpy.types.Context) -> str:
    """Return why the active object is not a terrain that can be changed, or an empty string."""
    terrain = terrain_of_object(context.active_object)
    return "Select a clip-box terrain" if terrain is None else terrain.read_only_reason


def context_viewer_matrix(context: bpy.types.Context) -> mathutils.Matrix:
    """Return the matrix in world space of the viewer: the 3D Viewport under the pointer, or the first one; see `viewer_matrix`."""
    region = context.region_data
    if region is None and context.screen is not None and not bpy.app.background:
        region = next((area.spaces.active.region_3d for area in context.screen.areas if area.type == "VIEW_3D"), None)
    return view_following.viewer_matrix(context.scene, region)


def viewer_position(context: bpy.types.Context) -> np.ndarray:
    """Return the position (3,) float64 of the viewer in world space."""
    return np.array(context_viewer_matrix(context).translation, np.float64)


CLASSES = (FARFIELD_PG_clipbox, FARFIELD_OT_clipbox_create, FARFIELD_OT_clipbox_update, FARFIELD_OT_clipbox_follow_view)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes and handlers, and add the settings to scenes."""
    register_classes()
    bpy.types.Scene.farfield_clipbox = bpy.props.PointerProperty(type=FARFIELD_PG_clipbox)
    handlers.register()


def unregister() -> None:
    """Unregister the handlers and classes, and remove the settings from scenes."""
    handlers.unregister()
    del bpy.types.Scene.farfield_clipbox
    unregister_classes()
