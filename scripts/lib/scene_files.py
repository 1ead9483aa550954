"""Reading scenes from all file formats that Blender reads, and writing `.blend` and `.obj` files."""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.geometry.meshes import is_collection_instance, may_have_surface
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.files.complete_files import is_complete_blend
from farfield.addon.core.files.far_meshes import near_origin
from farfield.addon.core.files.file_access import check_readable
from farfield.addon.core.files.ply_headers import read_ply_header
from farfield.addon.core.geometry.local_origin import describe_move
from lib.atomic_output import atomic_file, blender_error_message
from lib.run_files import RunFiles
from lib.script_stdout import mute_stderr


def _importers() -> dict[str, Callable[..., set[str]]]:
    """Return Blender's import operators by file name extension."""
    usd = dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), bpy.ops.wm.usd_import)
    gltf = dict.fromkeys((".glb", ".gltf"), bpy.ops.import_scene.gltf)
    others = {".obj": bpy.ops.wm.obj_import, ".ply": bpy.ops.wm.ply_import, ".stl": bpy.ops.wm.stl_import, ".fbx": bpy.ops.wm.fbx_import}
    return others | gltf | usd


def open_scene(path: Path, files: RunFiles | None = None) -> None:
    """Replace the scene by the contents of `path`: open a `.blend` file, import other formats into an empty scene.

    files: of the run; none of its outputs may replace a file of the scene.

    Raises:
        FileError: the file does not exist or is empty, its extension is unknown, Blender cannot read it, or a file of the scene would be
            replaced.
    """
    _check_file(path)
    _read(path, path)
    if files is not None:
        files.check_scene(path)


def open_near_origin(path: Path, files: RunFiles | None = None) -> np.ndarray | None:
    """Open a scene as `open_scene` does. A mesh file with coordinates that are too large for Blender is moved to the origin: return the
    position (3,) from where, None for other files. Raises FileError."""
    _check_file(path)
    with near_origin(path) as (near, origin):
        _read(near, path)
    if files is not None:
        files.check_scene(path)
    return origin


def _check_file(path: Path) -> None:
    """Raise FileError if Blender cannot read `path`, as far as its name, its size and the header of a .ply file tell."""
    check_readable(path)
    if path.suffix.lower() not in (".blend", *_importers()):
        raise FileError(f'"{path.name}" has the extension "{path.suffix.lower()}"; Farfield reads .blend {" ".join(_importers())}.')
    if path.stat().st_size == 0:  # Blender 5.2 fails to map it into memory
        raise FileError(f'"{path}" is empty; export it again.')
    if path.suffix.lower() == ".ply":
        read_ply_header(path)


def _read(path: Path, given: Path) -> None:
    """Open or import a file, which stands for the file `given` of the user. Raises FileError."""
    try:
        with mute_stderr():  # the operators also raise what they print
            if path.suffix.lower() == ".blend":
                bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
            else:
                bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
                _importers()[path.suffix.lower()](filepath=str(path))
    except RuntimeError as error:  # raised by Blender's operators
        raise FileError(f'Blender cannot read "{given}": {blender_error_message(error)}') from error


def describe_moved(origin: np.ndarray | None) -> str:
    """Return a sentence about a scene that `open_near_origin` moved from `origin`, "" if it did not."""
    return "" if origin is None else describe_move(origin, "The vertices")


def objects_in_renders(path: Path | None, is_wanted: Callable[[bpy.types.Object], bool] = may_have_surface) -> list[bpy.types.Object]:
    """Return those objects of the open scene, read from `path` or created by the script if it is None, that `is_wanted` accepts and that
    are visible in renders. Shapes of bones, which importers add, do not count.

    Raises:
        GeometryError: there are none.
    """
    place = "the scene" if path is None else f'"{path}"'
    shapes = find_bone_shapes()
    objects = [item for item in bpy.context.scene.objects if is_wanted(item) and item not in shapes]
    if not objects:
        raise GeometryError(f"There is no mesh in {place}{_explain_absence()}")
    visible = [item for item in objects if not item.hide_render]
    if not visible:
        names = ", ".join(item.name for item in objects)
        raise GeometryError(f"Every object in {place} is disabled in renders ({names}); enable one of them.")
    return visible


def find_bone_shapes() -> set[bpy.types.Object]:
    """Return the objects that show bones in the viewport."""
    return {bone.custom_shape for item in bpy.data.objects if item.pose is not None for bone in item.pose.bones} - {None}


def is_mesh(item: bpy.types.Object) -> bool:
    """Return whether an object is a mesh of its own."""
    return item.type == "MESH"


def describe_missing() -> list[str]:
    """Return the names of objects and collections that were linked from files that are not there, with the reason."""
    missing = [item for item in (*bpy.data.objects, *bpy.data.collections) if item.is_missing]
    return [f'{item.name} (the library "{item.library.filepath}" is missing)' for item in missing]


def describe_unread() -> list[str]:
    """Return the names of what a script that works on meshes ignores although it shows surfaces, with the reason."""
    instances = [item for item in bpy.context.scene.objects if is_collection_instance(item) and not item.hide_render]
    return [*(f"{item.name} (an instance of a collection; make it real)" for item in instances), *describe_missing()]


def _explain_absence() -> str:
    """Return why a scene has no mesh, as the end of a sentence."""
    missing = describe_missing()
    if missing:
        return f": {'; '.join(missing)}. Put the library back, or make its objects local."
    instances = [item.name for item in bpy.context.scene.objects if is_collection_instance(item)]
    if instances:
        return f", only instances of collections ({', '.join(instances)}); make them real (Object > Apply > Make Instances Real)."
    return "; give a file with an object that has faces."


def save_scene(path: Path) -> None:
    """Save the scene as `path`. The file appears complete or not at all, and its relative paths stay valid.

    Raises:
        FileError: the file cannot be written.
    """
    if bpy.data.filepath:
        bpy.ops.file.make_paths_absolute()  # relative paths would refer to the temporary folder
    with atomic_file(path) as temporary:
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True, check_existing=False, relative_remap=False)
        if not is_complete_blend(temporary) or not _can_be_opened(temporary):  # Blender reports no failed write of a compressed file
            raise FileError(f'Cannot write "{path}": the saved file is truncated, because the disk or your quota is full; free some space.')


def save_obj(path: Path) -> None:
    """Write all objects as `path`, a path of a temporary file: without materials and normals, and without the effect of modifiers.

    Raises:
        OSError: the disk is full.
    """
    bpy.ops.wm.obj_export(filepath=str(path), export_materials=False, export_normals=False, apply_modifiers=False)
    with path.open("ab") as file:  # Blender reports no failed write; after one, there is no room for another line either
        file.write(b"# end of file\n")


def _can_be_opened(path: Path) -> bool:
    """Whether Blender finds all blocks of a `.blend` file; none of their data is read."""
    try:
        with bpy.data.libraries.load(str(path)):
            return True
    except OSError:
        return False
