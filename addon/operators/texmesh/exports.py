"""Operator of the tool `texmesh` that writes levels as .glb files."""

from pathlib import Path

import bpy

from ...bridge.scene_paths import check_scene_outputs
from ...bridge.texmesh.glb_levels import level_outputs, write_levels
from ...core.errors import FileError
from ...core.files.file_access import is_folder
from ...core.files.filenames import safe_filename
from ...core.files.outputs import Output
from ...core.messages import join_sentences, list_first
from ...core.texmesh.settings import ExportSettings
from .. import long_work, properties
from ..error_reports import reports_errors
from ..file_browser import open_file_browser, remember_folder
from ..results import show_result
from .operators import NO_LEVELS, selected_level_sets

SUFFIX = ".glb"


class FARFIELD_OT_texmesh_export(bpy.types.Operator):
    """Write the levels of the selected objects as .glb files, with their images"""

    bl_idname = "farfield.texmesh_export"
    bl_label = "Export Perceptual Levels"
    bl_options = {"REGISTER"}
    __annotations__ = {
        "filepath": bpy.props.StringProperty(name="File", description="File to write", subtype="FILE_PATH", options={"SKIP_SAVE"}),
        "filter_glob": bpy.props.StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"}),
    } | properties.build_annotations(ExportSettings, set())

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether selected objects have levels."""
        return long_work.poll_with_reason(cls, "" if selected_level_sets(context) else NO_LEVELS)

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser; if a file is given, write it."""
        if self.filepath:
            return self.execute(context)
        return open_file_browser(self, context, safe_filename(selected_level_sets(context)[0].source_name) + SUFFIX)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the files."""
        path = Path(bpy.path.abspath(self.filepath)).absolute()
        if not self.filepath or path.suffix.lower() not in ("", SUFFIX):
            raise FileError(f'The file is "{self.filepath}"; its name must end in {SUFFIX}.')
        if is_folder(path):
            raise FileError(f'"{self.filepath}" is a folder; name a file in it.')
        path = path.with_suffix(SUFFIX)
        check_scene_outputs([Output("the file", path)] if self.one_file else level_outputs(path))
        paths, sentences = write_levels(selected_level_sets(context), path, properties.read(ExportSettings, self))
        remember_folder(self, context, path)
        show_result(self, context.scene, join_sentences([f"Saved {list_first(item.name for item in paths)}.", *sentences]))
        return {"FINISHED"}


CLASSES = (FARFIELD_OT_texmesh_export,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
