"""Operators of the tool `clipbox`: create a terrain, make it anew, let it follow."""

import bpy
import mathutils
import numpy as np

from ..bridge.terrain_objects import terrain_at
from ..core.clipbox.settings import ClipboxSettings
from ..core.errors import FarfieldError
from . import clipbox_following, long_work, properties
from .clipbox_following import BUDGET, Following
from .clipbox_job import ClipboxJob, prepare

TICK = 1.0 / 60.0


class FARFIELD_PG_clipbox(bpy.types.PropertyGroup):
    """What the panel *Clip-Box Terrain* holds, kept with each scene."""

    __annotations__ = properties.annotations(ClipboxSettings, set())


class FARFIELD_OT_clipbox_create(long_work.LongWork, bpy.types.Operator):
    """Make a terrain in nested boxes about this view, or about the scene's camera"""

    bl_idname = "farfield.clipbox_create"
    bl_label = "Create Clip-Box Terrain"
    bl_options = {"REGISTER", "UNDO"}
    # SKIP_SAVE: what the caller leaves out comes from the panel, not from the last call
    __annotations__ = properties.annotations(ClipboxSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether nothing else is under way."""
        return long_work.allowed(cls, refusal(context))

    def prepare(self, context: bpy.types.Context) -> ClipboxJob:
        """Take the settings and the viewer."""
        properties.fill_unset(ClipboxSettings, self, context.scene.farfield_clipbox)
        return prepare(properties.read(ClipboxSettings, self), viewer_of(context))


class FARFIELD_OT_clipbox_update(long_work.LongWork, bpy.types.Operator):
    """Make the active terrain anew with these settings, where it is"""

    bl_idname = "farfield.clipbox_update"
    bl_label = "Update Clip-Box Terrain"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.annotations(ClipboxSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether a terrain is active, and nothing else under way."""
        return long_work.allowed(cls, refusal(context) or refusal_of_active(context))

    def prepare(self, context: bpy.types.Context) -> ClipboxJob:
        """Take the settings."""
        properties.fill_unset(ClipboxSettings, self, context.scene.farfield_clipbox)
        standing = terrain_at(context.active_object)
        return prepare(properties.read(ClipboxSettings, self), standing.viewer, standing)


class FARFIELD_OT_clipbox_follow(bpy.types.Operator):
    """Let the active terrain follow this view, or the scene's camera where the view looks through it, until Esc is pressed"""

    bl_idname = "farfield.clipbox_follow"
    bl_label = "Follow"
    bl_options = {"REGISTER", "UNDO"}
    budget: bpy.props.FloatProperty(
        name="Budget",
        description="Milliseconds that Blender's main thread may spend at a time",
        default=1000.0 * BUDGET,
        min=1.0,
        max=100.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether a terrain is active, and nothing else under way."""
        return long_work.allowed(cls, refusal(context) or refusal_of_active(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Without a window: follow the camera once."""
        standing = terrain_at(context.active_object)
        try:
            clipbox_following.follow_at_once(standing, standing.seen_from(eye_of(context)))
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Begin to follow."""
        if context.window is None:
            return self.execute(context)
        self._following = Following(terrain_at(context.active_object))
        self._timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(f'"{self._following.standing.name}" follows (Esc ends)')
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Go on a little at every tick; all other events are the window's own."""
        if event.type == "ESC" and event.value == "PRESS":
            self._end(context)
            return {"FINISHED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        standing = self._following.standing
        if standing.root is None or self._following not in clipbox_following.followings:
            self._end(context)
            return {"FINISHED"}
        try:
            shown = self._following.tick(standing.seen_from(eye_of(context)), self.budget / 1000.0)
        except FarfieldError as error:
            self._end(context)
            self.report({"ERROR"}, str(error))
            return {"FINISHED"}
        if shown:
            long_work.redraw_sidebars(context.window_manager)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """The window closes or Blender quits."""
        self._end(context)

    def _end(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        self._following.close()


def refusal(context: bpy.types.Context) -> str:
    """Why no terrain can be made now, or an empty string."""
    if context.mode != "OBJECT":
        return "Go to Object Mode"
    return long_work.busy() or ("A terrain follows; end that with Esc" if clipbox_following.followings else "")


def refusal_of_active(context: bpy.types.Context) -> str:
    """Why nothing can be done with the active object, or an empty string."""
    return "" if terrain_at(context.active_object) is not None else "Select a clip-box terrain"


def eye_of(context: bpy.types.Context) -> mathutils.Matrix:
    """The matrix in world space of who looks: the view that the pointer is in or the first one, the scene's camera without any."""
    region = context.region_data
    if region is None and context.screen is not None and not bpy.app.background:
        region = next((area.spaces.active.region_3d for area in context.screen.areas if area.type == "VIEW_3D"), None)
    if context.scene.camera is not None and (region is None or region.view_perspective == "CAMERA"):
        return context.scene.camera.matrix_world
    return region.view_matrix.inverted() if region is not None else context.scene.cursor.matrix


def viewer_of(context: bpy.types.Context) -> np.ndarray:
    """Where in world space (3,) float64 who looks is."""
    return np.array(eye_of(context).translation, np.float64)


CLASSES = (FARFIELD_PG_clipbox, FARFIELD_OT_clipbox_create, FARFIELD_OT_clipbox_update, FARFIELD_OT_clipbox_follow)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes, hang the settings on scenes, and follow frames and undo."""
    register_classes()
    bpy.types.Scene.farfield_clipbox = bpy.props.PointerProperty(type=FARFIELD_PG_clipbox)
    clipbox_following.register()


def unregister() -> None:
    """The reverse."""
    clipbox_following.unregister()
    del bpy.types.Scene.farfield_clipbox
    unregister_classes()
