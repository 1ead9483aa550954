"""Operators of the tool `billboards`: build clouds, estimate them, show clouds or sources, select levels for the camera, cross-fade."""

import bpy

from ...bridge import cameras
from ...bridge.billboards import clouds
from ...bridge.billboards.scene_clouds import SceneCloud, clouds_in, find_cloud
from ...core.billboards.settings import BillboardSettings, CrossfadeSettings
from ...core.errors import FarfieldError
from .. import long_work, properties
from .estimates import cache, estimate_key
from .job import BillboardJob, BuildOptions, linked_sources_message, may_have_surface, prepare_job

SHOW_ITEMS = [
    ("TOGGLE", "Toggle", "Show the cloud if its original is visible, otherwise the original"),
    ("SOURCE", "Original", "Show the original and hide the cloud"),
    ("CLOUD", "Cloud", "Show the cloud and hide the original"),
]


class FARFIELD_PG_billboards(bpy.types.PropertyGroup):
    """Settings of the panel *Billboard Cloud*, stored per scene."""

    __annotations__ = {
        name: annotation
        for settings_type in (BillboardSettings, BuildOptions, CrossfadeSettings)
        for name, annotation in properties.build_annotations(settings_type, set()).items()
    }


class FARFIELD_OT_billboards_build(long_work.LongWork, bpy.types.Operator):
    """Create a billboard cloud with several levels of detail for each selected object"""

    bl_idname = "farfield.billboards_build"
    bl_label = "Build Billboard Cloud"
    bl_options = {"REGISTER", "UNDO"}
    # SKIP_SAVE: properties that the caller does not set come from the panel, not from the previous call
    __annotations__ = {
        name: annotation
        for settings_type in (BillboardSettings, BuildOptions)
        for name, annotation in properties.build_annotations(settings_type, {"SKIP_SAVE"}).items()
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the selection can be built and no job is running."""
        return long_work.poll_with_reason(cls, disabled_reason(context))

    def prepare(self, context: bpy.types.Context) -> BillboardJob:
        """Read the selected objects."""
        for settings_type in (BillboardSettings, BuildOptions):
            properties.fill_unset(settings_type, self, context.scene.farfield_billboards)
        settings, options = properties.read(BillboardSettings, self), properties.read(BuildOptions, self)
        return prepare_job(context, context.selected_objects, settings, options)


class FARFIELD_OT_billboards_estimate(bpy.types.Operator):
    """Estimate the quads, texels and texture memory of billboard clouds of the selected objects"""

    bl_idname = "farfield.billboards_estimate"
    bl_label = "Estimate Billboard Cloud"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the selection can be estimated."""
        return long_work.poll_with_reason(cls, disabled_reason(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Compute the estimate and store it for the panel."""
        try:
            settings = properties.read(BillboardSettings, context.scene.farfield_billboards)
            result = cache.compute(context, estimate_key(context, settings))
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        levels = [f"{level.quads:,} quads, {level.texels:,} texels, {level.bytes / 1e6:.1f} MB" for level in result.levels]
        self.report({"INFO"}, f"About {'; '.join(levels)}.")
        return {"FINISHED"}


class FARFIELD_OT_billboards_show(bpy.types.Operator):
    """Show either the original or the billboard cloud of the selected objects, in the viewport and in renders"""

    bl_idname = "farfield.billboards_show"
    bl_label = "Show Billboard Cloud or Original"
    bl_options = {"REGISTER", "UNDO"}

    show: bpy.props.EnumProperty(name="Show", description="What to show", items=SHOW_ITEMS, default="TOGGLE", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a selected object belongs to a cloud."""
        return long_work.poll_with_reason(cls, "" if selected_clouds(context) else "Select a billboard cloud or its original")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Change the visibility of all clouds of selected objects; the first cloud decides what toggling shows."""
        scene_clouds = selected_clouds(context)
        missing = [cloud for cloud in scene_clouds if not cloud.sources]
        show_cloud = self.show == "CLOUD" or (self.show == "TOGGLE" and scene_clouds[0].shows_sources)
        changed = scene_clouds if show_cloud else [cloud for cloud in scene_clouds if cloud.sources]
        for cloud in changed:
            if show_cloud:
                cloud.show_cloud()
            else:
                cloud.show_sources()
            cloud.activate_visible(context)
        linked = [name for cloud in changed for name in cloud.linked_source_names]
        message = f"Showing the {'cloud' if show_cloud else 'original'} of {_quote_names(changed)}." if changed else "Nothing changed."
        message += f" {linked_sources_message(linked)}" if linked else ""
        message += f" Without source objects: {_quote_names(missing)}." if missing else ""
        self.report({"WARNING" if linked or missing else "INFO"}, message)
        return {"FINISHED" if changed else "CANCELLED"}


class FARFIELD_OT_billboards_crossfade(bpy.types.Operator):
    """Cross-fade the levels of every billboard cloud and its original as the active camera moves. All levels render, and their materials
    are transparent where another level shows"""

    bl_idname = "farfield.billboards_crossfade"
    bl_label = "Cross-Fade Billboard Levels"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.build_annotations(CrossfadeSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there are a camera and a cloud."""
        return long_work.poll_with_reason(cls, _camera_disabled_reason(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add a cross-fade to every cloud of the scene."""
        properties.fill_unset(CrossfadeSettings, self, context.scene.farfield_billboards)
        fade_range = properties.read(CrossfadeSettings, self).fade_range
        scene_clouds = clouds_in(context.scene)
        for cloud in scene_clouds:
            cloud.add_crossfade(context, fade_range)
            cloud.activate_visible(context)
        linked = [name for cloud in scene_clouds for name in cloud.linked_source_names]
        message = f"Cross-fading for the active camera: {_quote_names(scene_clouds)}."
        missing = [cloud for cloud in scene_clouds if not cloud.sources]
        message += f" Without source objects: {_quote_names(missing)}." if missing else ""
        message += f" {linked_sources_message(linked)}" if linked else ""
        self.report({"WARNING" if linked else "INFO"}, message)
        return {"FINISHED"}


class FARFIELD_OT_billboards_show_level(bpy.types.Operator):
    """Show for each billboard cloud the coarsest level whose error is at most one pixel in the active camera, or the original when it is
    too near"""

    bl_idname = "farfield.billboards_show_level"
    bl_label = "Show Billboard Level for Camera"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there are a camera and a cloud."""
        return long_work.poll_with_reason(cls, _camera_disabled_reason(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show one level of every cloud of the scene and hide the others."""
        context.view_layer.update()
        camera = cameras.read_scene_camera(context.scene)
        shown, linked = [], []
        for cloud in clouds_in(context.scene):
            level = cloud.show_level_for(camera)
            cloud.activate_visible(context)
            linked += cloud.linked_source_names
            shown.append(f'"{cloud.collection.name}" {"original" if level is None else f"level {level}"}')
        message = f"Shown: {', '.join(shown)}." + (f" {linked_sources_message(linked)}" if linked else "")
        self.report({"WARNING" if linked else "INFO"}, message)
        return {"FINISHED"}


def selected_clouds(context: bpy.types.Context) -> list[SceneCloud]:
    """Return the clouds of the active object and of the selected objects, each once."""
    found = [find_cloud(context.scene, item) for item in (context.active_object, *context.selected_objects)]
    return list({cloud.collection.name: cloud for cloud in found if cloud is not None}.values())


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why nothing can be built now, or an empty string."""
    if long_work.running_job_message():
        return long_work.running_job_message()
    candidates = [item for item in context.selected_objects if may_have_surface(item)]
    if not candidates:
        return "Select an object with a surface"
    if all(clouds.KIND in item for item in candidates):
        return "Select an object, not its cloud"
    return ""


def _camera_disabled_reason(context: bpy.types.Context) -> str:
    """Return why no level can be selected for the camera, or an empty string."""
    if cameras.read_scene_camera(context.scene) is None:
        return "The scene has no active camera"
    return "" if clouds_in(context.scene) else "The scene has no billboard cloud"


def _quote_names(scene_clouds: list[SceneCloud]) -> str:
    return ", ".join(f'"{cloud.collection.name}"' for cloud in scene_clouds)


CLASSES = (
    FARFIELD_PG_billboards,
    FARFIELD_OT_billboards_build,
    FARFIELD_OT_billboards_estimate,
    FARFIELD_OT_billboards_show,
    FARFIELD_OT_billboards_crossfade,
    FARFIELD_OT_billboards_show_level,
)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes and add the settings to scenes."""
    register_classes()
    bpy.types.Scene.farfield_billboards = bpy.props.PointerProperty(type=FARFIELD_PG_billboards)


def unregister() -> None:
    """Remove the settings from scenes and unregister the classes."""
    cache.clear()
    del bpy.types.Scene.farfield_billboards
    unregister_classes()
