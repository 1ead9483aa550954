"""Blender as a program: redrawing of its editors, the messages of its errors, and the Python modules that it brings along."""

import importlib
from types import ModuleType

import bpy

from ..core.errors import FileError


def redraw_areas(*types: str) -> None:
    """Redraw all areas of some types in all windows, such as "VIEW_3D"; all areas if none is given."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if not types or area.type in types:
                area.tag_redraw()


def error_sentence(error: RuntimeError) -> str:
    """Return the message of an error that a function of Blender raised, on one line, without its final full stop: of an error of an add-on
    its last line, without the traceback."""
    lines = [line for line in str(error).splitlines() if not line.startswith("Location:")]
    message = lines[-1].partition(": ")[2] if "Traceback" in str(error) else " ".join(lines).removeprefix("Error: ")
    return " ".join(message.split()).rstrip(".")


def import_blender_module(name: str, purpose: str, advice: str) -> ModuleType:
    """Import a module that is part of Blender, such as OpenImageIO.

    purpose and advice are the beginning and the end of the message of the error, for instance 'Reading "a.exr"' and "use another Blender".

    Raises:
        FileError: this Blender lacks the module, or it does not load.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        problem = "lacks" if isinstance(error, ModuleNotFoundError) else f"cannot load ({reason})"
        raise FileError(f"{purpose} needs the module {name}, which this Blender {problem}; {advice}.") from error
