"""Operators of the tool `unwrap`: unwrap meshes, set the importance direction from the view, show and save UV stretch."""

from pathlib import Path

import bpy
from mathutils import Vector

from ...bridge.scene_paths import check_scene_outputs
from ...bridge.unwrap import uv_maps
from ...bridge.unwrap.stretch_display import overlay, save_stretch_image
from ...core.files.filenames import safe_filename
from ...core.files.outputs import Output
from ...core.messages import format_number
from ...core.unwrap.settings import UnwrapSettings
from .. import long_work, properties, start_job
from ..error_reports import report_message, reports_errors
from ..file_browser import open_file_browser, remember_folder
from .job import UnwrapJob, prepare


class FARFIELD_PG_unwrap(bpy.types.PropertyGroup):
    """Settings of the panel *Unwrap*, stored per scene."""

    settings_types = (UnwrapSettings,)
    __annotations__ = properties.build_annotations(UnwrapSettings, set())


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why nothing can be unwrapped now, or an empty string."""
    if context.mode not in ("OBJECT", "EDIT_MESH"):
        return "Switch to Object Mode or Edit Mode"
    has_mesh = any(item.type == "MESH" for item in target_objects(context))
    return long_work.running_job_message() or ("" if has_mesh else "Select a mesh object")


class FARFIELD_OT_unwrap(start_job.StartJob, bpy.types.Operator):
    """Create low-stretch UV maps for the selected meshes, or for the selected faces in Edit Mode, with more texels in important areas"""

    bl_idname = "farfield.unwrap"
    bl_label = "Unwrap with Low Stretch"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (UnwrapSettings,), "farfield_unwrap"
    disabled_reason = staticmethod(disabled_reason)
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> UnwrapJob:
        """Read the selected meshes."""
        return prepare(context, target_objects(context), self.read_settings(context)[UnwrapSettings])


class FARFIELD_OT_unwrap_direction(bpy.types.Operator):
    """Set the importance direction from the current view"""

    bl_idname = "farfield.unwrap_direction"
    bl_label = "Set Importance Direction from View"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the operator is called from a 3D Viewport."""
        return long_work.poll_with_reason(cls, "" if context.region_data is not None else "Only available in a 3D Viewport")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the direction from the surface to the viewer."""
        context.scene.farfield_unwrap.direction = context.region_data.view_rotation @ Vector((0.0, 0.0, 1.0))
        return {"FINISHED"}


class FARFIELD_OT_unwrap_texel_density(bpy.types.Operator):
    """Set the texel density to that of the active object in its active UV map, for the texture size in the panel"""

    bl_idname = "farfield.unwrap_texel_density"
    bl_label = "Set Texel Density from Active UV Map"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the active object has a UV map."""
        item = context.active_object
        has_map = item is not None and item.type == "MESH" and item.mode == "OBJECT" and bool(item.data.uv_layers)
        return long_work.poll_with_reason(cls, "" if has_map else "Activate a mesh object with a UV map in Object Mode")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the texel density."""
        item, settings = context.active_object, properties.read(UnwrapSettings, context.scene.farfield_unwrap)
        target, unit_length = uv_maps.read_uv_target(item, None), uv_maps.read_unit_length(context.scene)
        uv_map = item.data.uv_layers.active.name
        density = uv_maps.measure_texel_densities(item.data, target, [uv_map], settings.texture, unit_length)[uv_map]
        context.scene.farfield_unwrap.texel_density = density
        report_message(self, f'The texel density of "{uv_map}" is {format_number(density)} px/m.')
        return {"FINISHED"}


class FARFIELD_OT_unwrap_overlay(bpy.types.Operator):
    """Color faces by UV stretch in 3D Viewports and UV Editors: white is undistorted, red is stretched, blue is compressed"""

    bl_idname = "farfield.unwrap_overlay"
    bl_label = "Show UV Stretch"
    bl_options = {"REGISTER"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show or hide the overlay."""
        if overlay.is_shown:
            overlay.hide()
        else:
            overlay.show()
        return {"FINISHED"}


class FARFIELD_OT_unwrap_stretch_image(bpy.types.Operator):
    """Save an image of the active object's UV map, colored by stretch"""

    bl_idname = "farfield.unwrap_stretch_image"
    bl_label = "Save Stretch Image"
    bl_options = {"REGISTER"}
    __annotations__ = {
        "filepath": bpy.props.StringProperty(subtype="FILE_PATH"),
        "filter_glob": bpy.props.StringProperty(default="*.png", options={"HIDDEN"}),
        "resolution": bpy.props.IntProperty(name="Resolution", description="Pixels per side", default=1024, min=64, max=8192),
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the active object has been unwrapped."""
        return long_work.poll_with_reason(cls, "" if is_unwrapped(context.active_object) else "Unwrap a mesh first")

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        return open_file_browser(self, context, safe_filename(f"{context.active_object.name} stretch") + ".png")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Draw the image and write it."""
        path = Path(bpy.path.abspath(self.filepath)).with_suffix(".png")
        check_scene_outputs([Output("the image", path)])
        save_stretch_image(context.active_object, path, self.resolution)
        remember_folder(self, context, path)
        report_message(self, f'Saved "{path}".')
        return {"FINISHED"}


def target_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the objects to unwrap: those in Edit Mode, otherwise the selected ones."""
    if context.mode == "EDIT_MESH":
        return list(context.objects_in_mode_unique_data)
    return list(context.selected_objects)


def is_unwrapped(item: bpy.types.Object | None) -> bool:
    """Return whether an object is a mesh that this tool has unwrapped."""
    return item is not None and item.type == "MESH" and bool(uv_maps.read_metrics(item.data))


CLASSES = (
    FARFIELD_PG_unwrap,
    FARFIELD_OT_unwrap,
    FARFIELD_OT_unwrap_direction,
    FARFIELD_OT_unwrap_texel_density,
    FARFIELD_OT_unwrap_overlay,
    FARFIELD_OT_unwrap_stretch_image,
)
register, unregister_settings = properties.scene_settings_factory("farfield_unwrap", FARFIELD_PG_unwrap, CLASSES)


def unregister() -> None:
    """Hide the overlay, remove the settings from scenes and unregister the classes."""
    overlay.hide()
    unregister_settings()
