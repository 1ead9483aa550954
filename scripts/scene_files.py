"""Scenes out of files of all kinds that Blender reads, and into `.blend` files."""

from collections.abc import Callable
from pathlib import Path

import bpy

import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from whole_files import quiet_operators, said_by_blender, whole_file


def _importers() -> dict[str, Callable[..., set[str]]]:
    """Blender's operators by the ending of the files that they read."""
    usd = dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), bpy.ops.wm.usd_import)
    gltf = dict.fromkeys((".glb", ".gltf"), bpy.ops.import_scene.gltf)
    plain = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import, ".stl": bpy.ops.wm.stl_import, ".fbx": bpy.ops.wm.fbx_import}
    return plain | gltf | usd


def open_scene(path: Path) -> None:
    """Replace the scene by what `path` holds: a `.blend` as it is, other formats imported into an empty scene.

    Raises:
        FileError: when there is no such file, its ending is unknown, or Blender cannot read it.
    """
    if not path.is_file():
        raise FileError(f'There is no file "{path}"; check the path.')
    importers = _importers()
    ending = path.suffix.lower()
    if ending != ".blend" and ending not in importers:
        raise FileError(f'"{path.name}" ends in "{ending}"; Farfield reads .blend {" ".join(importers)}.')
    try:
        if ending == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
        else:
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            with quiet_operators():
                importers[ending](filepath=str(path))
    except RuntimeError as error:  # what Blender's operators raise
        raise FileError(f'Blender cannot read "{path}": {said_by_blender(error)}') from error


def save_scene(path: Path) -> None:
    """Save the scene as `path`, whole or not at all; the paths of its files stay right.

    Raises:
        FileError: when it cannot be written.
    """
    if bpy.data.filepath:
        bpy.ops.file.make_paths_absolute()  # relative ones would be counted from the temporary folder
    with whole_file(path) as temporary:
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True, check_existing=False, relative_remap=False)
