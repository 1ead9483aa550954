"""Operators of the tool `clipbox`: create and update a terrain, and let it follow the view."""

import bpy
import mathutils
import numpy as np

from ...bridge.clipbox.objects import terrain_of_object
from ...core.clipbox.settings import ClipboxSettings
from ...core.errors import FarfieldError
from .. import long_work, properties
from . import following
from .following import MAX_TICK_SECONDS, Following
from .job import TerrainJob, prepare

TICK = 1.0 / 60.0  # seconds between two timer events


class FARFIELD_PG_clipbox(bpy.types.PropertyGroup):
    """Settings of the panel *Clip-Box Terrain*, stored per scene."""

    __annotations__ = properties.build_annotations(ClipboxSettings, set())


class FARFIELD_OT_clipbox_create(long_work.LongWork, bpy.types.Operator):
    """Create a terrain in nested boxes around the current view, or around the active camera if the view looks through it"""

    bl_idname = "farfield.clipbox_create"
    bl_label = "Create Clip-Box Terrain"
    bl_options = {"REGISTER", "UNDO"}
    # SKIP_SAVE: properties that the caller leaves unset come from the panel, not from the last call
    __annotations__ = properties.build_annotations(ClipboxSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether nothing else runs."""
        return long_work.poll_with_reason(cls, disabled_reason(context))

    def prepare(self, context: bpy.types.Context) -> TerrainJob:
        """Read the settings and the viewer position."""
        properties.fill_unset(ClipboxSettings, self, context.scene.farfield_clipbox)
        return prepare(properties.read(ClipboxSettings, self), viewer_position(context))


class FARFIELD_OT_clipbox_update(long_work.LongWork, bpy.types.Operator):
    """Rebuild the active terrain with the current settings"""

    bl_idname = "farfield.clipbox_update"
    bl_label = "Update Terrain"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.build_annotations(ClipboxSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain is active and nothing else runs."""
        return long_work.poll_with_reason(cls, disabled_reason(context) or disabled_reason_of_active(context))

    def prepare(self, context: bpy.types.Context) -> TerrainJob:
        """Read the settings and the active terrain."""
        properties.fill_unset(ClipboxSettings, self, context.scene.farfield_clipbox)
        terrain = terrain_of_object(context.active_object)
        return prepare(properties.read(ClipboxSettings, self), terrain.viewer, terrain)


class FARFIELD_OT_clipbox_follow_view(bpy.types.Operator):
    """Keep the active terrain centered on this view, or on the active camera if the view looks through it, until Esc is pressed"""

    bl_idname = "farfield.clipbox_follow_view"
    bl_label = "Follow View with Terrain"
    bl_options = {"REGISTER", "UNDO"}
    budget: bpy.props.FloatProperty(
        name="Budget",
        description="Maximum time per update on Blender's main thread, in milliseconds",
        default=1000.0 * MAX_TICK_SECONDS,
        min=1.0,
        max=100.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain is active and nothing else runs."""
        return long_work.poll_with_reason(cls, disabled_reason(context) or disabled_reason_of_active(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: recenter the terrain once."""
        terrain = terrain_of_object(context.active_object)
        try:
            following.recenter(terrain, terrain.viewer_position(viewer_matrix(context)))
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start following."""
        if context.window is None:
            return self.execute(context)
        self._following = Following(terrain_of_object(context.active_object))
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f'"{self._following.terrain.name}" is following the view (Esc to stop)')
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Continue with every timer event. All other events pass through, except Esc."""
        if event.type == "ESC" and event.value == "PRESS":
            self._clean_up(context)
            return {"FINISHED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        terrain = self._following.terrain
        if terrain.root is None or self._following not in following.running():
            self._clean_up(context)
            return {"FINISHED"}
        try:
            was_shown = self._following.tick(terrain.viewer_position(viewer_matrix(context)), self.budget / 1000.0)
        except FarfieldError as error:
            self._clean_up(context)
            self.report({"ERROR"}, str(error))
            return {"FINISHED"}
        if was_shown:
            long_work.redraw_sidebars(context.window_manager)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop when the window closes or Blender quits."""
        self._clean_up(context)

    def _clean_up(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        self._following.close()


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why no terrain can be created now, or an empty string."""
    if context.mode != "OBJECT":
        return "Switch to Object Mode"
    is_following = bool(following.running())
    return long_work.running_job_message() or ("A terrain is following the view; press Esc to stop it" if is_following else "")


def disabled_reason_of_active(context: bpy.types.Context) -> str:
    """Return why the active object is not a terrain, or an empty string."""
    return "" if terrain_of_object(context.active_object) is not None else "Select a clip-box terrain"


def viewer_matrix(context: bpy.types.Context) -> mathutils.Matrix:
    """Return the matrix of the viewer in world space.

    The viewer is the 3D Viewport under the pointer, or the first one. Without a viewport, or if it looks through the active camera, the
    viewer is that camera. Without a camera it is the 3D cursor.
    """
    region = context.region_data
    if region is None and context.screen is not None and not bpy.app.background:
        region = next((area.spaces.active.region_3d for area in context.screen.areas if area.type == "VIEW_3D"), None)
    if context.scene.camera is not None and (region is None or region.view_perspective == "CAMERA"):
        return context.scene.camera.matrix_world
    return region.view_matrix.inverted() if region is not None else context.scene.cursor.matrix


def viewer_position(context: bpy.types.Context) -> np.ndarray:
    """Return the position (3,) float64 of the viewer in world space."""
    return np.array(viewer_matrix(context).translation, np.float64)


CLASSES = (FARFIELD_PG_clipbox, FARFIELD_OT_clipbox_create, FARFIELD_OT_clipbox_update, FARFIELD_OT_clipbox_follow_view)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes and handlers, and add the settings to scenes."""
    register_classes()
    bpy.types.Scene.farfield_clipbox = bpy.props.PointerProperty(type=FARFIELD_PG_clipbox)
    following.register()


def unregister() -> None:
    """Unregister the handlers and classes, and remove the settings from scenes."""
    following.unregister()
    del bpy.types.Scene.farfield_clipbox
    unregister_classes()
