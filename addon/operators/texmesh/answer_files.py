"""Operators that exchange the answers of judges between scenes, as files."""

from pathlib import Path

import bpy

from ...bridge.scene_paths import check_scene_outputs
from ...core.errors import FileError
from ...core.files.atomic_write import write_bytes_atomically
from ...core.files.file_access import read_file
from ...core.files.outputs import Output
from ...core.messages import format_count
from ...core.texmesh.perception.recorded_answers import MAX_ANSWER_BYTES, decode_answers, merge_answers, write_answers
from .. import long_work
from ..error_reports import report_message, reports_errors
from ..file_browser import open_file_browser, remember_folder
from .calibration_run import ANSWERS, stored_answers

SUFFIX = ".json"
FILTER = bpy.props.StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})


class FARFIELD_OT_texmesh_save_answers(bpy.types.Operator):
    """Write the recorded answers to a file, for other scenes and for scripts"""

    bl_idname = "farfield.texmesh_save_answers"
    bl_label = "Save Answers of Calibration"
    bl_options = {"REGISTER"}
    __annotations__ = {
        "filepath": bpy.props.StringProperty(name="File", description="File to write", subtype="FILE_PATH", options={"SKIP_SAVE"}),
        "filter_glob": FILTER,
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there are answers."""
        return long_work.poll_with_reason(cls, "" if context.scene.get(ANSWERS) else "Calibrate first")

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser; if a file is given, write it."""
        if self.filepath:
            return self.execute(context)
        return open_file_browser(self, context, f"answers{SUFFIX}")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the file."""
        path = Path(bpy.path.abspath(self.filepath)).absolute()
        if not self.filepath or path.suffix.lower() != SUFFIX:
            raise FileError(f'The file is "{self.filepath}"; its name must end in {SUFFIX}.')
        check_scene_outputs([Output("the file of answers", path)])
        records = stored_answers(context.scene)
        write_bytes_atomically(path, write_answers(records).encode())
        remember_folder(self, context, path)
        report_message(self, f"Wrote {format_count(len(records), 'answer')}.")
        return {"FINISHED"}


class FARFIELD_OT_texmesh_add_answers(bpy.types.Operator):
    """Add the answers in files of other judges to those of the scene; an answer that several have counts once"""

    bl_idname = "farfield.texmesh_add_answers"
    bl_label = "Add Answers of Other Judges"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {
        "filepath": bpy.props.StringProperty(name="File", description="File of answers", subtype="FILE_PATH", options={"SKIP_SAVE"}),
        "files": bpy.props.CollectionProperty(name="Files", type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"}),
        "directory": bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"}),
        "filter_glob": FILTER,
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the scene can be changed."""
        return long_work.poll_with_reason(cls, "" if context.scene.is_editable else "The scene is linked from a library")

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser; if a file is given, read it."""
        if self.filepath:
            return self.execute(context)
        return open_file_browser(self, context)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the files."""
        names = [str(Path(self.directory) / item.name) for item in self.files if item.name] or [self.filepath]
        added = [decode_answers(read_file(Path(bpy.path.abspath(name)), MAX_ANSWER_BYTES), name) for name in names]
        remember_folder(self, context, Path(bpy.path.abspath(names[0])))
        own = stored_answers(context.scene)
        merged = merge_answers([own, *added])
        context.scene[ANSWERS] = write_answers(merged)
        report_message(self, f"Added {format_count(len(merged) - len(own), 'answer')}; the scene has {len(merged)}.")
        return {"FINISHED"}


CLASSES = (FARFIELD_OT_texmesh_save_answers, FARFIELD_OT_texmesh_add_answers)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
