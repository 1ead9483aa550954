"""Blender as a program: its editors, data that nothing uses, the messages of its errors, and the Python modules that it brings along."""

import importlib
from collections.abc import Iterable
from types import ModuleType

import bpy

from ..core.errors import FileError


def redraw_areas(*types: str) -> None:
    """Redraw all areas of some types in all windows, such as "VIEW_3D"; all areas if none is given."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if not types or area.type in types:
                area.tag_redraw()


def remove_unused_data(*kinds: Iterable[bpy.types.ID | None]) -> None:
    """Remove data without users, one kind after the other, since the first ones may use later ones, such as meshes, materials, images."""
    for blocks in kinds:
        bpy.data.batch_remove([block for block in dict.fromkeys(blocks) if block is not None and not block.users])


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
