"""Reading scenes from all file formats that Blender reads, and writing `.blend` files."""

from collections.abc import Callable
from pathlib import Path

import bpy

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from lib.atomic_output import atomic_file, blender_error_message, suppress_operator_tracebacks


def _importers() -> dict[str, Callable[..., set[str]]]:
    """Return Blender's import operators by file name extension."""
    usd = dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), bpy.ops.wm.usd_import)
    gltf = dict.fromkeys((".glb", ".gltf"), bpy.ops.import_scene.gltf)
    others = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import, ".stl": bpy.ops.wm.stl_import, ".fbx": bpy.ops.wm.fbx_import}
    return others | gltf | usd


def open_scene(path: Path) -> None:
    """Replace the scene by the contents of `path`: open a `.blend` file, import other formats into an empty scene.

    Raises:
        FileError: the file does not exist, its extension is unknown, or Blender cannot read it.
    """
    if not path.is_file():
        raise FileError(f'The file "{path}" does not exist; check the path.')
    importers = _importers()
    extension = path.suffix.lower()
    if extension != ".blend" and extension not in importers:
        raise FileError(f'"{path.name}" has the extension "{extension}"; Farfield reads .blend {" ".join(importers)}.')
    try:
        if extension == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
        else:
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            with suppress_operator_tracebacks():
                importers[extension](filepath=str(path))
    except RuntimeError as error:  # raised by Blender's operators
        raise FileError(f'Blender cannot read "{path}": {blender_error_message(error)}') from error


def save_scene(path: Path) -> None:
    """Save the scene as `path`. The file appears complete or not at all, and its relative paths stay valid.

    Raises:
        FileError: the file cannot be written.
    """
    if bpy.data.filepath:
        bpy.ops.file.make_paths_absolute()  # relative paths would refer to the temporary folder
    with atomic_file(path) as temporary:
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True, check_existing=False, relative_remap=False)
