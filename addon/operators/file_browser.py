"""File browsers that open where the same operator opened or wrote a file last."""

import itertools
import os
from pathlib import Path

import bpy

from ..bridge.scene_paths import default_folder

FOLDERS = "farfield_folders"  # Custom property of the window manager, which no file keeps: the latest folder, by operator.


def open_file_browser(operator: bpy.types.Operator, context: bpy.types.Context, filename: str = "", folder: Path | None = None) -> set[str]:
    """Open the file browser of `operator`, and return the result of its `invoke`.

    filename: is proposed. folder: where it opens for the first time, by default that of the open file.
    """
    start = find_start_folder(operator.bl_idname, context, folder)
    if hasattr(operator, "filepath"):
        operator.filepath = f"{start}{os.sep}{filename}"
    else:
        operator.directory = f"{start}{os.sep}"
    context.window_manager.fileselect_add(operator)
    return {"RUNNING_MODAL"}


def find_start_folder(operator_name: str, context: bpy.types.Context, folder: Path | None = None) -> Path:
    """Return the folder in which an operator opened or wrote a file last, for the first time `folder`, by default that of the open file.

    operator_name: the name of its class.
    """
    known = context.window_manager.get(FOLDERS, {}).get(operator_name)
    return Path(known) if known and Path(known).is_dir() else folder or default_folder()


def propose_folder(path: Path) -> Path:
    """Return `path`, with a number if that exists already: a proposal replaces nothing."""
    paths = (path if number == 1 else path.with_name(f"{path.name} {number}") for number in itertools.count(1))
    return next(each for each in paths if not each.exists())


def remember_folder(operator: bpy.types.Operator, context: bpy.types.Context, path: Path) -> None:
    """Let the next file browser of `operator` open in the folder of `path`, a file or what was chosen in it."""
    folders = dict(context.window_manager.get(FOLDERS, {}))
    context.window_manager[FOLDERS] = folders | {operator.bl_idname: str(path.absolute().parent)}
