"""Levels of a scene as .glb files: one per level, or one with all levels of each object (MSFT_lod and MSFT_screencoverage).

Blender's exporter writes meshes and materials; the nodes and the encoding of numbers are Farfield's.
"""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import addon_utils
import bpy
import numpy as np

from ...core.errors import FileError
from ...core.files.atomic_write import atomic_folder
from ...core.files.file_access import convert_os_errors
from ...core.files.glb import Y_UP, Document, is_own_glb, load_glb, save_glb
from ...core.files.glb_levels import LevelNode, arrange_levels
from ...core.files.outputs import Output
from ...core.files.temporary_folders import temporary_folder
from ...core.messages import describe_lacking
from ...core.texmesh.perception.switch_distances import level_coverages
from ..blender import error_sentence
from ..objects import world_matrix
from .glb_objects import GlbObjects
from .level_sets import LevelSet

GLTF = "io_scene_gltf2"  # Blender's add-on
OPTIONS = {
    "export_all_vertex_colors": False,
    "export_active_vertex_color_when_no_material": False,
    "export_animations": False,
    "export_try_sparse_sk": False,
    "export_current_frame": True,
    "export_hierarchy_full_collections": True,  # The collection need not be in a scene.
}


def write_levels(
    sets: Sequence[LevelSet], path: Path, is_quantized: bool = True, is_one_file: bool = False
) -> tuple[list[Path], list[str]]:
    """Write levels and return the files: `path` if it is one file, otherwise one per level next to it, see `level_path`. Also return
    sentences about what the files lack.

    File N has level N of every object, or its coarsest one. All files appear, or none.

    Raises:
        FileError: a file cannot be written, or an image cannot be read. GeometryError: an object has no triangles or is in Edit Mode.
    """
    count = 1 if is_one_file else max(len(levels.levels) for levels in sets)
    paths = [path if is_one_file else level_path(path, number) for number in range(count)]
    with GlbObjects() as objects, atomic_folder(path.parent) as folder:
        for number, target in enumerate(paths):
            nodes = list_nodes(sets, objects, None if is_one_file else number)
            document = export_collection(objects.collection)
            objects.note_document(document)
            arranged = arrange_levels(document, nodes, is_quantized, objects.material_names, objects.unlit, objects.armature_names)
            (folder / target.name).write_bytes(save_glb(arranged))
        lacking = objects.lacking
    return paths, describe_lacking(lacking, "The .glb" if is_one_file else "Each .glb")


def level_outputs(path: Path, others: Sequence[Path] = ()) -> list[Output]:
    """Return the files next to `path` that have names of its levels; `write_levels` may replace those that Farfield wrote.

    others: paths that need not exist, which may also have such names.

    Raises:
        FileError: its folder cannot be read.
    """
    pattern = re.compile(re.escape(path.stem) + r"-L\d+" + re.escape(path.suffix), re.IGNORECASE)
    with convert_os_errors(f'Cannot read "{path.parent}"'):
        found = sorted(other for other in path.parent.iterdir() if pattern.fullmatch(other.name)) if path.parent.is_dir() else []
    found += [other for other in others if other.parent.resolve() == path.parent.resolve() and pattern.fullmatch(other.name)]
    return [Output(f'the level "{other.name}"', other, is_ours=is_own_glb) for other in dict.fromkeys(found)]


def level_path(path: Path, number: int) -> Path:
    """Return the file of one level: `chair-L2.glb` for level 2 and `chair.glb`."""
    return path.with_name(f"{path.stem}-L{number}{path.suffix}")


def list_nodes(sets: Sequence[LevelSet], objects: GlbObjects, number: int | None) -> list[LevelNode]:
    """Let `objects` be those of the level `number` of each object, or its coarsest one, or of all levels if it is None: the finest one is
    then replaced by the others as it covers less of the image. Return the nodes of the file."""
    objects.clear()
    nodes: list[LevelNode] = []
    for levels in sets:
        first, bounds = len(nodes), _bounds(levels)
        indices = range(len(levels.levels)) if number is None else [min(number, len(levels.levels) - 1)]
        for index in indices:
            item = levels.levels[index]
            source = objects.add(item, levels.source_name)
            others = tuple(range(first + 1, first + len(indices))) if len(nodes) == first else ()
            name = f"{levels.label}_LOD{index}"
            nodes.append(LevelNode(source, name, bounds, _matrix(item), others, _coverages(levels) if others else ()))
    return nodes


def export_collection(collection: bpy.types.Collection) -> Document:
    """Return the document of the file that Blender's exporter writes of a collection.

    Raises:
        FileError: it cannot write an image or the file.
    """
    layer, errors = bpy.context.view_layer, io.StringIO()
    active = layer.objects.active
    with temporary_folder() as folder, enabled_gltf(), redirect_stdout(io.StringIO()), redirect_stderr(errors):
        path = folder / "levels.glb"
        layer.objects.active = None  # Or the exporter would leave its mode.
        try:
            bpy.ops.export_scene.gltf(filepath=str(path), collection=collection.name, **OPTIONS)
        except RuntimeError as error:  # raised by Blender
            raise FileError(f"Blender's glTF exporter failed: {error_sentence(error)}.") from error
        finally:
            layer.objects.active = active
        with convert_os_errors(f'Cannot read "{path}"'):
            content = path.read_bytes()
    messages = [line.partition("ERROR: ")[2] for line in errors.getvalue().splitlines() if "ERROR: " in line]
    if messages:  # such as an image that it could not write
        raise FileError(f"Blender's glTF exporter failed: {messages[-1]}. Free disk space and try again.")
    return load_glb(content)


@contextmanager
def enabled_gltf() -> Iterator[None]:
    """Enable Blender's add-on for glTF meanwhile."""
    was_enabled = addon_utils.check(GLTF)[1]
    if not was_enabled:
        addon_utils.enable(GLTF)
    try:
        yield
    finally:
        if not was_enabled:
            addon_utils.disable(GLTF)


def _matrix(item: bpy.types.Object) -> np.ndarray:
    """Return the matrix (4, 4) to the world with y upwards."""
    axes = np.eye(4)
    axes[:3, :3] = Y_UP
    return axes @ np.array(world_matrix(item), np.float64) @ axes.T


def _bounds(levels: LevelSet) -> np.ndarray:
    """Return the lowest and highest positions (2, 3) of all levels, so that all are rounded alike."""
    corners = np.concatenate([np.array(item.bound_box) for item in levels.levels]) @ Y_UP.T
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def _coverages(levels: LevelSet) -> tuple[float, ...]:
    """Return the fraction of the image down to which each level shows, descending; the last one shows at any size."""
    box = np.array(levels.levels[0].bound_box)
    return level_coverages(levels.errors[1:], np.stack([box.min(axis=0), box.max(axis=0)]))
