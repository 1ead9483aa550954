"""Blender as a program: redrawing of its editors, the messages of its errors, and the Python modules that it brings along.

These modules are importable inside Blender, but not on the search path of pip's bpy.
"""

import importlib
import importlib.machinery
import importlib.util
import sys
from pathlib import Path
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
    if name in sys.modules:
        return sys.modules[name]
    try:
        if importlib.util.find_spec(name) is not None:
            return importlib.import_module(name)
        module = _import_from(bundled_folders(), name)
    except ImportError as error:
        reason = str(error).partition("\n")[0].rstrip(".")
        raise FileError(f"{purpose} needs the module {name}, which this Blender cannot load ({reason}); {advice}.") from error
    if module is None:
        raise FileError(f"{purpose} needs the module {name}, which this Blender lacks; {advice}.")
    return module


def bundled_folders() -> list[Path]:
    """Return the folders with Blender's own modules.

    They are lib/python3.x/site-packages below Blender's folder `python` on Linux and macOS, and lib/site-packages on Windows.
    """
    return sorted((Path(bpy.utils.resource_path("LOCAL")) / "python").rglob("site-packages"))


def _import_from(folders: list[Path], name: str) -> ModuleType | None:
    """Import the module from one of `folders` without adding them to the search path: they hold other versions of installed packages.

    Returns None if none of them contains it. Raises ImportError if it does not load.
    """
    spec = importlib.machinery.PathFinder.find_spec(name, [str(folder) for folder in folders])
    if spec is None or spec.loader is None:
        return None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except ImportError:
        del sys.modules[name]
        raise
    return module
