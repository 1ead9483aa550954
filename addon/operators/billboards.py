"""Operators of the tool `billboards`: build clouds, estimate them beforehand, show the level that suits the camera or let levels fade."""

import bpy

from ..bridge import cameras
from ..core.billboards.settings import BillboardSettings, FadeSettings
from ..core.errors import FarfieldError
from . import billboards_estimates, long_work, properties
from .billboards_clouds import StandingCloud, clouds_in
from .billboards_job import BillboardJob, BuildOptions, may_have_surface, prepare


class FARFIELD_PG_billboards(bpy.types.PropertyGroup):
    """What the panel *Billboard Cloud* holds, kept with each scene."""

    __annotations__ = {
        name: annotation
        for settings_type in (BillboardSettings, BuildOptions, FadeSettings)
        for name, annotation in properties.annotations(settings_type, set()).items()
    }


class FARFIELD_OT_billboards_build(long_work.LongWork, bpy.types.Operator):
    """Let few textured quads stand for each selected mesh, in levels for growing distances"""

    bl_idname = "farfield.billboards_build"
    bl_label = "Build Billboard Cloud"
    bl_options = {"REGISTER", "UNDO"}
    # SKIP_SAVE: what the caller leaves out comes from the panel, not from the last call
    __annotations__ = properties.annotations(BillboardSettings, {"SKIP_SAVE"}) | properties.annotations(BuildOptions, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether there is something to build from, and nothing else under way."""
        return long_work.allowed(cls, refusal(context))

    def prepare(self, context: bpy.types.Context) -> BillboardJob:
        """Read the selected objects."""
        for settings_type in (BillboardSettings, BuildOptions):
            properties.fill_unset(settings_type, self, context.scene.farfield_billboards)
        return prepare(context, context.selected_objects, properties.read(BillboardSettings, self), properties.read(BuildOptions, self))


class FARFIELD_OT_billboards_estimate(bpy.types.Operator):
    """Tell beforehand how many quads, texels and megabytes the selected objects will take"""

    bl_idname = "farfield.billboards_estimate"
    bl_label = "Estimate"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether there is something to estimate."""
        return long_work.allowed(cls, refusal(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Estimate and keep the figures for the panel."""
        try:
            settings = properties.read(BillboardSettings, context.scene.farfield_billboards)
            found = billboards_estimates.answer(context, billboards_estimates.question(context, settings))
        except FarfieldError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        levels = [f"{level.quads:,} quads, {level.texels:,} texels, {level.bytes / 1e6:.1f} MB" for level in found.levels]
        self.report({"INFO"}, f"About {'; '.join(levels)}.")
        return {"FINISHED"}


class FARFIELD_OT_billboards_fade(bpy.types.Operator):
    """Let the levels of each cloud and its original fade into each other as the scene's camera moves: all of them render, and their
    materials let through what another level shows"""

    bl_idname = "farfield.billboards_fade"
    bl_label = "Cross-fade Levels"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = properties.annotations(FadeSettings, {"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether there are a camera and a cloud."""
        return long_work.allowed(cls, _no_view(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Dress every cloud of the scene."""
        properties.fill_unset(FadeSettings, self, context.scene.farfield_billboards)
        span = properties.read(FadeSettings, self).fade_range
        standing = clouds_in(context.scene)
        for cloud in standing:
            cloud.fade(context, span)
            _hand_over(context, cloud)
        names = ", ".join(f'"{cloud.collection.name}"' for cloud in standing)
        alone = [f'"{cloud.collection.name}"' for cloud in standing if not cloud.sources]
        missing = f" Without their originals, which are gone: {', '.join(alone)}." if alone else ""
        self.report({"INFO"}, f"Fading for the scene's camera: {names}.{missing}")
        return {"FINISHED"}


class FARFIELD_OT_billboards_show_level(bpy.types.Operator):
    """Show of each cloud the coarsest level that looks like the original from the scene's camera, or the original itself when it is near"""

    bl_idname = "farfield.billboards_show_level"
    bl_label = "Show Level for Camera"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether there are a camera and a cloud."""
        return long_work.allowed(cls, _no_view(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Hide and show."""
        context.view_layer.update()
        camera = cameras.scene_camera(context.scene)
        shown = []
        for cloud in clouds_in(context.scene):
            level = cloud.show_for(camera)
            _hand_over(context, cloud)
            shown.append(f'"{cloud.collection.name}" {"original" if level is None else f"level {level}"}')
        self.report({"INFO"}, f"Shown: {', '.join(shown)}.")
        return {"FINISHED"}


def _hand_over(context: bpy.types.Context, cloud: StandingCloud) -> None:
    """Let what is shown of `cloud` be the active object where what was active is hidden now: the panel goes by it."""
    active = context.view_layer.objects.active
    own = [*cloud.levels, *cloud.sources]
    shown = [item for item in own if not item.hide_viewport]
    if active in own and active.hide_viewport and shown:
        context.view_layer.update()
        context.view_layer.objects.active = shown[0]
        shown[0].select_set(True)


def _no_view(context: bpy.types.Context) -> str:
    """Why no level can be chosen, or an empty string."""
    if cameras.scene_camera(context.scene) is None:
        return "The scene has no camera"
    return "" if clouds_in(context.scene) else "The scene has no billboard cloud"


def refusal(context: bpy.types.Context) -> str:
    """Why nothing can be built now, or an empty string."""
    chosen = any(may_have_surface(item) for item in context.selected_objects)
    return long_work.busy() or ("" if chosen else "Select an object with a surface")


CLASSES = (
    FARFIELD_PG_billboards,
    FARFIELD_OT_billboards_build,
    FARFIELD_OT_billboards_estimate,
    FARFIELD_OT_billboards_fade,
    FARFIELD_OT_billboards_show_level,
)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes and hang the settings on scenes."""
    register_classes()
    bpy.types.Scene.farfield_billboards = bpy.props.PointerProperty(type=FARFIELD_PG_billboards)


def unregister() -> None:
    """The reverse."""
    billboards_estimates.forget()
    del bpy.types.Scene.farfield_billboards
    unregister_classes()
