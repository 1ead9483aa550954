"""Operators of the tool `unwrap`: unwrap what is selected, take the direction of importance from the view, show and save stretch."""

from pathlib import Path

import bpy
from mathutils import Vector

from ..bridge import stretch_pictures, uv_maps, uv_overlay
from ..core.errors import FarfieldError
from ..core.unwrap.settings import UnwrapSettings
from . import long_work, properties
from .unwrap_job import UnwrapJob, prepare


class FARFIELD_PG_unwrap(bpy.types.PropertyGroup):
    """What the panel *View-Dependent Unwrap* holds, kept with each scene."""

    __annotations__ = properties.annotations(UnwrapSettings, set())


class FARFIELD_OT_unwrap(long_work.LongWork, bpy.types.Operator):
    """Lay out the selected meshes, or the selected faces in Edit Mode, with little stretch, and with most texels where it matters"""

    bl_idname = "farfield.unwrap"
    bl_label = "View-Dependent Unwrap"
    bl_options = {"REGISTER", "UNDO"}
    # SKIP_SAVE: what the caller leaves out comes from the panel, not from the last call
    __annotations__ = properties.annotations(UnwrapSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether there is something to unwrap, and nothing else under way."""
        return long_work.allowed(cls, refusal(context))

    def prepare(self, context: bpy.types.Context) -> UnwrapJob:
        """Read the selected meshes."""
        properties.fill_unset(UnwrapSettings, self, context.scene.farfield_unwrap)
        return prepare(context, chosen(context), properties.read(UnwrapSettings, self))


class FARFIELD_OT_unwrap_direction(bpy.types.Operator):
    """Let what this view sees matter: take its direction for importance"""

    bl_idname = "farfield.unwrap_direction"
    bl_label = "From View"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether this is a 3D view."""
        return long_work.allowed(cls, "" if context.region_data is not None else "Use it in a 3D view")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Take the direction from the surface to the viewer."""
        context.scene.farfield_unwrap.direction = context.region_data.view_rotation @ Vector((0.0, 0.0, 1.0))
        return {"FINISHED"}


class FARFIELD_OT_unwrap_overlay(bpy.types.Operator):
    """Colour the faces of unwrapped meshes by stretch in 3D views and UV editors: white has none, red is stretched, blue is crowded"""

    bl_idname = "farfield.unwrap_overlay"
    bl_label = "Show Stretch"
    bl_options = {"REGISTER"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Switch it on or off."""
        uv_overlay.switch(not uv_overlay.shown())
        for window in context.window_manager.windows:
            for area in window.screen.areas:
                area.tag_redraw()
        return {"FINISHED"}


class FARFIELD_OT_unwrap_picture(bpy.types.Operator):
    """Save a picture of the active mesh's UV map, coloured by stretch"""

    bl_idname = "farfield.unwrap_picture"
    bl_label = "Save Stretch Picture"
    bl_options = {"REGISTER"}
    __annotations__ = {
        "filepath": bpy.props.StringProperty(subtype="FILE_PATH"),
        "filter_glob": bpy.props.StringProperty(default="*.png", options={"HIDDEN"}),
        "size": bpy.props.IntProperty(name="Size", description="Pixels along a side", default=1024, min=64, max=8192),
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active mesh has been unwrapped."""
        return long_work.allowed(cls, "" if is_unwrapped(context.active_object) else "Unwrap a mesh first")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask where to."""
        self.filepath = f"{context.active_object.name} stretch.png"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Draw and write it."""
        path = Path(bpy.path.abspath(self.filepath)).with_suffix(".png")
        try:
            stretch_pictures.save(context.active_object, path, self.size)
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f'Saved "{path}".')
        return {"FINISHED"}


def chosen(context: bpy.types.Context) -> list[bpy.types.Object]:
    """What the operator works on: the objects that are edited, or those selected."""
    if context.mode == "EDIT_MESH":
        return list(context.objects_in_mode_unique_data)
    return list(context.selected_objects)


def is_unwrapped(item: bpy.types.Object | None) -> bool:
    """Whether an object is a mesh that this tool has unwrapped."""
    return item is not None and item.type == "MESH" and bool(uv_maps.figures_of(item.data))


def refusal(context: bpy.types.Context) -> str:
    """Why nothing can be unwrapped now, or an empty string."""
    if context.mode not in ("OBJECT", "EDIT_MESH"):
        return "Go to Object Mode or Edit Mode"
    has_mesh = any(item.type == "MESH" for item in chosen(context))
    return long_work.busy() or ("" if has_mesh else "Select a mesh")


CLASSES = (
    FARFIELD_PG_unwrap,
    FARFIELD_OT_unwrap,
    FARFIELD_OT_unwrap_direction,
    FARFIELD_OT_unwrap_overlay,
    FARFIELD_OT_unwrap_picture,
)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes and hang the settings on scenes."""
    register_classes()
    bpy.types.Scene.farfield_unwrap = bpy.props.PointerProperty(type=FARFIELD_PG_unwrap)


def unregister() -> None:
    """The reverse."""
    uv_overlay.switch(False)
    del bpy.types.Scene.farfield_unwrap
    unregister_classes()
