"""Operator of the tool `btf` that exports relightable textures to other programs."""

from pathlib import Path

import bpy

from ...core.btf.settings import ExportSettings
from ...core.files.filenames import safe_filename
from .. import long_work, properties
from ..error_reports import reports_errors
from ..file_browser import open_file_browser, remember_folder
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
        path = Path(bpy.path.abspath(self.filepath))
        remember_folder(self, context, path)
        return prepare_export(active_cloud(context).levels, path, properties.read(ExportSettings, self))

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser; if a file is given, start the job."""
        if self.filepath:
            return super().invoke(context, event)
        return open_file_browser(self, context, safe_filename(active_cloud(context).collection.name) + FMF)

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
