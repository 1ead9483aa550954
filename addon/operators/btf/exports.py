"""Operator of the tool `btf` that exports relightable textures to other programs."""

from pathlib import Path

import bpy

from ...bridge.scene_paths import default_folder
from ...core.btf.settings import ExportSettings
from .. import long_work, properties
from ..error_reports import reports_errors
from .export_job import FMF, FORMATS, BtfExportJob, prepare_export
from .operators import active_cloud, not_baked_reason


class FARFIELD_OT_btf_export(long_work.LongWork, bpy.types.Operator):
    """Export the active relightable cloud as .glb, .btf, octahedral atlas, or folder of images"""

    bl_idname = "farfield.btf_export"
    bl_label = "Export Relightable Textures"
    __annotations__ = {
        "filepath": bpy.props.StringProperty(
            name="File",
            description="The suffix selects the format: .glb, .btf, .octahedral for a folder with an atlas, none for a folder of images",
            subtype="FILE_PATH",
            options={"SKIP_SAVE"},
        ),
        "filter_glob": bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in FORMATS if suffix), options={"HIDDEN"}),
    } | properties.build_annotations(ExportSettings, set())

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active cloud has relightable textures and no other job runs."""
        return long_work.poll_with_reason(cls, disabled_reason(context))

    def prepare(self, context: bpy.types.Context) -> BtfExportJob:
        """Read the textures of all levels."""
        settings = properties.read(ExportSettings, self)
        return prepare_export(active_cloud(context).levels, Path(bpy.path.abspath(self.filepath)), settings)

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser; if a file is given, start the job."""
        if self.filepath:
            return super().invoke(context, event)
        self.filepath = str(default_folder() / (bpy.path.clean_name(active_cloud(context).collection.name) + FMF))
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Run to the end. After the file browser, invoke the operator again with the file, so that the interface does not freeze."""
        if context.window is None or not self.options.is_invoke:
            return super().execute(context)
        try:
            bpy.ops.farfield.btf_export("INVOKE_DEFAULT", filepath=self.filepath, directions=self.directions)
        except RuntimeError as error:
            self.report({"ERROR"}, str(error).strip().removeprefix("Error: "))
            return {"CANCELLED"}
        return {"FINISHED"}


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why nothing can be exported now, or an empty string."""
    return long_work.running_job_message() or not_baked_reason(context)


CLASSES = (FARFIELD_OT_btf_export,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
