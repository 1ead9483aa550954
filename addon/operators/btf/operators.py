"""Operators of the tool `btf`: bake relightable textures for a cloud, link Sun lights to it, restore its PBR materials."""

import bpy

from ...bridge.billboards.level_objects import PBR_MATERIAL
from ...bridge.billboards.scene_clouds import SceneCloud, find_cloud
from ...bridge.btf.levels import emission_levels as btf_clouds
from ...bridge.btf.levels.level_checks import is_editable
from ...bridge.btf.materials.emission_material import SUNS
from ...core.btf.capture.capture_run import remove_expired
from ...core.btf.settings import BtfSettings
from ...core.files.user_folders import open_private_folder
from .. import long_work, properties, start_job
from ..error_reports import report_message, reports_errors
from ..results import show_result
from ..user_cache import cache_folder
from . import estimates
from .job import BakeJob, prepare_bake


def sun_pointer_name(index: int) -> str:
    """Return the property of the panel's settings that points to Sun `index`."""
    return f"sun_{index + 1}"


def _is_sun(_group: bpy.types.PropertyGroup, item: bpy.types.Object) -> bool:
    return item.type == "LIGHT" and item.data.type == "SUN"


class FARFIELD_PG_btf(bpy.types.PropertyGroup):
    """Settings of the panel *Relightable Textures*, stored per scene."""

    settings_types = (BtfSettings,)
    __annotations__ = (
        properties.build_annotations(BtfSettings, set())
        | {
            sun_pointer_name(index): bpy.props.PointerProperty(
                name=f"Sun {index + 1}", description="Sun light that lights the cloud", type=bpy.types.Object, poll=_is_sun
            )
            for index in range(SUNS)
        }
        | {
            "ambient": bpy.props.FloatVectorProperty(
                name="Ambient", description="Color of uniform World lighting", subtype="COLOR", size=3, min=0.0, soft_max=1.0
            )
        }
    )


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why nothing can be baked now, or an empty string."""
    no_cloud = "" if active_cloud(context) is not None else "Build a billboard cloud first, or select one or its original"
    return long_work.running_job_message() or no_cloud or linked_reason(context)


class FARFIELD_OT_btf_bake(start_job.StartJob, bpy.types.Operator):
    """Bake textures that change with the view and light direction for the active billboard cloud, with Cycles"""

    bl_idname = "farfield.btf_bake"
    bl_label = "Bake Relightable Textures"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (BtfSettings,), "farfield_btf"
    disabled_reason = staticmethod(disabled_reason)
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> BakeJob:
        """Read the source objects of the active cloud. Finished views are kept in a folder of the user until it ends."""
        settings = self.read_settings(context)[BtfSettings]
        cloud = active_cloud(context)
        cache = cache_folder("btf")
        open_private_folder(cache)
        remove_expired(cache)
        return prepare_bake(context, cloud, settings, estimates.capture_folder(cloud, settings), keep_finished_views=False)


class RequiresBakedCloud:
    """Mixin of operators that change relightable textures."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active cloud has relightable textures that can be changed."""
        return long_work.poll_with_reason(cls, not_baked_reason(context) or linked_reason(context))


class FARFIELD_OT_btf_link_suns(RequiresBakedCloud, bpy.types.Operator):
    """Light the active cloud with the selected Sun lights and the ambient color. Rotating a linked light relights the cloud"""

    bl_idname = "farfield.btf_link_suns"
    bl_label = "Link Sun Lights to Cloud"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active cloud has relightable textures that show linked lights only."""
        reason = not_baked_reason(context) or linked_reason(context)
        if not reason and not shows_linked_suns(active_cloud(context)):
            reason = "The cloud is lit by all lights of the scene"
        return long_work.poll_with_reason(cls, reason)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Replace the drivers of all levels."""
        group = context.scene.farfield_btf
        suns = [sun for sun in (getattr(group, sun_pointer_name(index)) for index in range(SUNS)) if sun is not None]
        for level in active_cloud(context).levels:
            btf_clouds.link_suns(level, suns, group.ambient)
        report_message(self, f"Lit by {', '.join(sun.name for sun in suns) or 'the ambient color only'}.")
        return {"FINISHED"}


class FARFIELD_OT_btf_restore_pbr(RequiresBakedCloud, bpy.types.Operator):
    """Remove the relightable textures of the active cloud. Its PBR materials also work with many lights or an environment texture"""

    bl_idname = "farfield.btf_restore_pbr"
    bl_label = "Restore PBR Materials"
    bl_options = {"REGISTER", "UNDO"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Restore the PBR materials of all levels."""
        cloud = active_cloud(context)
        for level in cloud.levels:
            btf_clouds.restore_pbr_material(level)
        show_result(self, context.scene, f'"{cloud.collection.name}" has its PBR materials again.')
        return {"FINISHED"}


def active_cloud(context: bpy.types.Context) -> SceneCloud | None:
    """Return the cloud that the active object is a level or a source of."""
    return find_cloud(context.scene, context.active_object)


def is_baked(cloud: SceneCloud | None) -> bool:
    """Whether a cloud has relightable materials."""
    return cloud is not None and all(PBR_MATERIAL in level for level in cloud.levels)


def shows_linked_suns(cloud: SceneCloud) -> bool:
    """Whether any level shows linked Sun lights only."""
    return any(btf_clouds.needs_linked_suns(level) for level in cloud.levels)


def linked_reason(context: bpy.types.Context) -> str:
    """Return why the materials of the active cloud cannot be changed, or an empty string."""
    return "" if is_editable(active_cloud(context)) else "The cloud is linked from another file; make it local first"


def not_baked_reason(context: bpy.types.Context) -> str:
    """Return why an operator on relightable textures is disabled, or an empty string."""
    return "" if is_baked(active_cloud(context)) else "Select a billboard cloud with relightable textures"


CLASSES = (FARFIELD_PG_btf, FARFIELD_OT_btf_bake, FARFIELD_OT_btf_link_suns, FARFIELD_OT_btf_restore_pbr)
register, unregister_settings = properties.scene_settings_factory("farfield_btf", FARFIELD_PG_btf, CLASSES)


def unregister() -> None:
    """Unregister them and discard all estimates."""
    estimates.cache.clear()
    unregister_settings()
