"""Operator of the tool `btf` that writes relightable textures for other programs."""

from pathlib import Path

import bpy

from ..core.btf.settings import ExportSettings
from . import long_work, properties
from .btf import chosen, is_baked
from .btf_export_job import FMF, KINDS, BtfExportJob, prepare


class FARFIELD_OT_btf_export(long_work.LongWork, bpy.types.Operator):
    """Write the active relightable cloud for other programs: .glb, .btf, an octahedral atlas, or a folder of pictures"""

    bl_idname = "farfield.btf_export"
    bl_label = "Export Relightable Textures"
    __annotations__ = {
        "filepath": bpy.props.StringProperty(
            name="File",
            description="Its ending says what is written: .glb, .btf, .octahedral for a folder with an atlas, none for pictures",
            subtype="FILE_PATH",
            options={"SKIP_SAVE"},
        ),
        "filter_glob": bpy.props.StringProperty(default=";".join(f"*{ending}" for ending in KINDS if ending), options={"HIDDEN"}),
    } | properties.annotations(ExportSettings, set())
    _timer = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active cloud has relightable textures and nothing else is under way."""
        return long_work.allowed(cls, refusal(context))

    def prepare(self, context: bpy.types.Context) -> BtfExportJob:
        """Read the textures of all levels."""
        settings = properties.read(ExportSettings, self)
        return prepare(chosen(context).levels, Path(bpy.path.abspath(self.filepath)), settings)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for a file; with one, start the work."""
        if self.filepath:
            return super().invoke(context, event)
        folder = Path(bpy.data.filepath).parent if bpy.data.filepath else Path.home()
        self.filepath = str(folder / (bpy.path.clean_name(chosen(context).collection.name) + FMF))
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Run to the end; behind the file browser, start once more with its file, so that the window stays free."""
        if context.window is None or not self.options.is_invoke:
            return super().execute(context)
        try:
            bpy.ops.farfield.btf_export("INVOKE_DEFAULT", filepath=self.filepath, directions=self.directions)
        except RuntimeError as error:
            self.report({"ERROR"}, str(error).strip().removeprefix("Error: "))
            return {"CANCELLED"}
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """The window closes, or no file was chosen."""
        if self._timer is not None:
            super().cancel(context)


def refusal(context: bpy.types.Context) -> str:
    """Why nothing can be exported now, or an empty string."""
    return long_work.busy() or ("" if is_baked(chosen(context)) else "Select a billboard cloud with relightable textures")


CLASSES = (FARFIELD_OT_btf_export,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
