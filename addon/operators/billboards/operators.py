"""Operators of the tool `billboards`: build clouds, estimate them, show clouds or sources, select levels for the camera, cross-fade."""

from collections.abc import Callable
from functools import partial

import bpy

from ...bridge import cameras
from ...bridge.billboards import clouds
from ...bridge.billboards.scene_clouds import SceneCloud, clouds_in, clouds_of_levels, find_cloud
from ...bridge.geometry.meshes import may_have_surface
from ...bridge.units import format_length
from ...core.billboards.settings import BillboardSettings, BuildOptions, CrossfadeSettings
from .. import long_work, properties, start_job
from ..error_reports import report_message, reports_errors
from ..view_following import show_textures, viewport_address
from .estimates import cache, estimate_key
from .job import BillboardJob, describe_counts, prepare_job
from .sources import describe_exceptions, missing_original_message, quote_clouds

SHOW_ITEMS = [
    ("TOGGLE", "Toggle", "Show the cloud if its original is visible, otherwise the original"),
    ("SOURCE", "Original", "Show the original and hide the cloud"),
    ("CLOUD", "Cloud", "Show the cloud and hide the original"),
]


class FARFIELD_PG_billboards(bpy.types.PropertyGroup):
    """Settings of the panel *Billboard Cloud*, stored per scene."""

    settings_types = (BillboardSettings, BuildOptions, CrossfadeSettings)
    __annotations__ = {
        name: annotation
        for settings_type in (BillboardSettings, BuildOptions, CrossfadeSettings)
        for name, annotation in properties.build_annotations(settings_type, set()).items()
    }


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why nothing can be built now, or an empty string."""
    if long_work.running_job_message():
        return long_work.running_job_message()
    candidates = [item for item in context.selected_objects if may_have_surface(item)]
    if not candidates:
        return "Select an object with a surface"
    if not context.scene.is_editable:
        return "The scene is linked from a library"
    if any(clouds.KIND not in item for item in candidates):
        return ""
    scene_clouds = clouds_of_levels(context.scene, candidates)
    if any(cloud.sources and not cloud.missing_source_names for cloud in scene_clouds):
        return ""
    return f"Select an object: of this cloud {missing_original_message(scene_clouds[0])}" if scene_clouds else "Select an object"


class FARFIELD_OT_billboards_build(start_job.StartJob, bpy.types.Operator):
    """Create a billboard cloud with several levels of detail for each selected object, or one for all of them, or build a selected cloud
    again from its original"""

    bl_idname = "farfield.billboards_build"
    bl_label = "Build Billboard Cloud"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (BillboardSettings, BuildOptions), "farfield_billboards"
    disabled_reason = staticmethod(disabled_reason)
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> BillboardJob:
        """Read the selected objects, and the originals of selected clouds."""
        settings = self.read_settings(context)
        return prepare_job(context, context.selected_objects, settings[BillboardSettings], settings[BuildOptions])

    def prepare_follow_up(self, context: bpy.types.Context) -> Callable[[], None]:
        """Return what lets the Solid view show the textures of quads, instead of the quads."""
        return partial(show_textures, viewport_address(context))


class FARFIELD_OT_billboards_estimate(bpy.types.Operator):
    """Estimate the triangles, quads, texels and texture memory of billboard clouds of the selected objects"""

    bl_idname = "farfield.billboards_estimate"
    bl_label = "Estimate Billboard Cloud"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the selection can be estimated."""
        return long_work.poll_with_reason(cls, disabled_reason(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Compute the estimate and store it for the panel."""
        settings = properties.read(BillboardSettings, context.scene.farfield_billboards)
        result = cache.compute(context, estimate_key(context, settings))
        levels = [
            f"{describe_counts(level.triangles, level.mesh_triangles, level.quads)}, {level.texels:,} texels, {level.bytes / 1e6:.1f} MB"
            for level in result.levels
        ]
        report_message(self, f"About {'; '.join(levels)}.")
        return {"FINISHED"}


class FARFIELD_OT_billboards_show(bpy.types.Operator):
    """Show either the original or the billboard cloud of the selected objects, in the viewport and in renders"""

    bl_idname = "farfield.billboards_show"
    bl_label = "Show Billboard Cloud or Original"
    bl_options = {"REGISTER", "UNDO"}

    show: bpy.props.EnumProperty(name="Show", description="What to show", items=SHOW_ITEMS, default="TOGGLE", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a selected object belongs to a cloud that can be changed."""
        scene_clouds = selected_clouds(context)
        reason = "" if scene_clouds else "Select a billboard cloud or its original"
        if scene_clouds and not any(cloud.is_editable for cloud in scene_clouds):
            reason = "The cloud is linked from a library; make it local first"
        return long_work.poll_with_reason(cls, reason)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Change the visibility of all clouds of selected objects; the first cloud decides what toggling shows."""
        view_layer = context.view_layer
        scene_clouds, refused = _split(selected_clouds(context), lambda cloud: cloud.is_editable)
        show_cloud = self.show == "CLOUD" or (self.show == "TOGGLE" and scene_clouds[0].shows_sources)
        can_show = [cloud.is_in(view_layer) if show_cloud else bool(cloud.sources_in(view_layer)) for cloud in scene_clouds]
        changed = [cloud for cloud, can_be_shown in zip(scene_clouds, can_show, strict=True) if can_be_shown]
        for cloud in changed:
            if show_cloud:
                cloud.show_cloud()
            else:
                cloud.show_sources()
            cloud.activate_visible(context)
        exceptions = describe_exceptions(scene_clouds, refused, view_layer)
        message = f"Showing the {'cloud' if show_cloud else 'original'} of {quote_clouds(changed)}." if changed else "Nothing changed."
        report_message(self, f"{message} {exceptions}".strip(), "WARNING" if exceptions else "INFO")
        return {"FINISHED" if changed else "CANCELLED"}


class FARFIELD_OT_billboards_crossfade(bpy.types.Operator):
    """Cross-fade the levels of billboard clouds and their originals as the active camera moves, or end it. All levels render then, and
    their materials are transparent where another level shows"""

    bl_idname = "farfield.billboards_crossfade"
    bl_label = "Cross-Fade Billboard Levels"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.build_annotations(CrossfadeSettings, {"SKIP_SAVE"}) | {
        "enable": bpy.props.BoolProperty(
            name="Enable", description="Cross-fade. When off, show one level for the active camera", default=True, options={"SKIP_SAVE"}
        ),
        "selected": bpy.props.BoolProperty(
            name="Selected", description="Only the clouds of selected objects, instead of all of the scene", options={"SKIP_SAVE"}
        ),
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there are a camera and a cloud."""
        return long_work.poll_with_reason(cls, _camera_disabled_reason(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add a cross-fade to the clouds, or remove it."""
        properties.fill_unset(CrossfadeSettings, self, context.scene.farfield_billboards)
        fade_range = properties.read(CrossfadeSettings, self).fade_range
        wanted = selected_clouds(context) if self.selected else clouds_in(context.scene)
        scene_clouds, refused = _split(wanted, lambda cloud: cloud.can_crossfade and (self.enable or cloud.has_crossfade))
        context.view_layer.update()
        camera = cameras.read_scene_camera(context.scene)
        for cloud in scene_clouds:
            if self.enable:
                cloud.add_crossfade(context, fade_range)
            else:
                cloud.show_level_for(camera, context.view_layer)
            cloud.activate_visible(context)
        exceptions = describe_exceptions(scene_clouds, refused if self.enable else [], context.view_layer)
        what = "Cross-fading for the active camera" if self.enable else "One level for the active camera"
        message = f"{what}: {quote_clouds(scene_clouds)}." if scene_clouds else "Nothing changed."
        report_message(self, f"{message} {exceptions}".strip(), "WARNING" if exceptions else "INFO")
        return {"FINISHED" if scene_clouds else "CANCELLED"}


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

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show one level of every cloud of the scene and hide the others."""
        context.view_layer.update()
        camera = cameras.read_scene_camera(context.scene)
        scene_clouds, refused = _split(clouds_in(context.scene), lambda cloud: cloud.is_editable)
        shown = []
        for cloud in scene_clouds:
            level = cloud.show_level_for(camera, context.view_layer)
            cloud.activate_visible(context)
            near = f"original, nearer than {format_length(context.scene, camera.switch_distance(cloud.errors[0]))}"
            shown.append(f'"{cloud.collection.name}" {near if level is None else f"level {level}"}')
        exceptions = describe_exceptions(scene_clouds, refused, context.view_layer)
        message = f"Shown: {'; '.join(shown)}." if shown else "Nothing changed."
        report_message(self, f"{message} {exceptions}".strip(), "WARNING" if exceptions else "INFO")
        return {"FINISHED" if shown else "CANCELLED"}


def selected_clouds(context: bpy.types.Context) -> list[SceneCloud]:
    """Return the clouds of the active object and of the selected objects, each once."""
    found = [find_cloud(context.scene, item) for item in (context.active_object, *context.selected_objects)]
    return list({cloud.collection.name: cloud for cloud in found if cloud is not None}.values())


def _camera_disabled_reason(context: bpy.types.Context) -> str:
    """Return why no level can be selected for the camera, or an empty string."""
    if cameras.read_scene_camera(context.scene) is None:
        return "The scene has no active camera"
    return "" if clouds_in(context.scene) else "The scene has no billboard cloud"


def _split(scene_clouds: list[SceneCloud], accepts: Callable[[SceneCloud], bool]) -> tuple[list[SceneCloud], list[SceneCloud]]:
    """Return the clouds that `accepts` accepts, and the others."""
    return [cloud for cloud in scene_clouds if accepts(cloud)], [cloud for cloud in scene_clouds if not accepts(cloud)]


CLASSES = (
    FARFIELD_PG_billboards,
    FARFIELD_OT_billboards_build,
    FARFIELD_OT_billboards_estimate,
    FARFIELD_OT_billboards_show,
    FARFIELD_OT_billboards_crossfade,
    FARFIELD_OT_billboards_show_level,
)
register, unregister_settings = properties.scene_settings_factory("farfield_billboards", FARFIELD_PG_billboards, CLASSES)


def unregister() -> None:
    """Remove the settings from scenes and unregister the classes."""
    cache.clear()
    unregister_settings()
