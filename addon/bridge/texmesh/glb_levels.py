"""Levels of a scene as .glb files: one per level, or one with all levels of each object (MSFT_lod and MSFT_screencoverage).

Blender's exporter writes meshes and materials; the nodes and the encoding of numbers are Farfield's.
"""

import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import SettingsError
from ...core.files.atomic_write import atomic_folder
from ...core.files.file_access import convert_os_errors
from ...core.files.glb import Y_UP, Document, is_own_glb, load_glb, save_glb
from ...core.files.glb_levels import COMPRESSIBLE, FULL, LevelNode, arrange_levels, merge_images
from ...core.files.outputs import Output
from ...core.files.temporary_folders import temporary_folder
from ...core.messages import describe_lacking
from ...core.texmesh.perception.switch_distances import level_coverages
from ...core.texmesh.rebaking.rebake import rebake_images
from ...core.texmesh.rebaking.texture_uses import LevelDocument
from ...core.texmesh.settings import ExportSettings
from ..gltf_export import export_gltf
from ..objects import world_matrix
from .glb_objects import GlbObjects
from .level_sets import LevelSet

DEFAULTS = ExportSettings()
OPTIONS = {
    "export_all_vertex_colors": False,
    "export_active_vertex_color_when_no_material": False,
    "export_try_sparse_sk": False,
    "export_current_frame": True,
    "export_hierarchy_full_collections": True,  # The collection need not be in a scene.
}


def write_levels(sets: Sequence[LevelSet], path: Path, settings: ExportSettings = DEFAULTS) -> tuple[list[Path], list[str]]:
    """Write levels and return the files: `path` if it is one file, otherwise one per level next to it, see `level_path`. Also return
    sentences about images, and about what the files lack.

    File N has level N of every object, or its coarsest one. All files appear, or none.

    Raises:
        FileError: a file cannot be written, or an image cannot be read. GeometryError: an object has no triangles or is in Edit Mode.
        SettingsError: a module that the settings need is missing.
    """
    has_codecs = _check_modules(settings)
    count = 1 if settings.one_file else max(len(levels.levels) for levels in sets)
    paths = [path if settings.one_file else level_path(path, number) for number in range(count)]
    is_rebaked = settings.rebake_textures and count > 1 and has_codecs
    with GlbObjects() as objects, atomic_folder(path.parent) as folder:
        nodes, levels = [], []
        for number in range(count):
            nodes.append(list_nodes(sets, objects, None if settings.one_file else number))
            document = export_collection(objects.collection, is_rebaked)
            objects.note_document(document)
            pixel_sizes = {node.source: node.pixel_size if is_rebaked else 0.0 for node in nodes[-1]}
            levels.append(LevelDocument(document, pixel_sizes, objects.uv_maps))
        merge_images([level.document for level in levels])
        sentences = rebake_images(levels, settings.webp) if is_rebaked or settings.webp else []
        for level, target, found in zip(levels, paths, nodes, strict=True):
            precision = None if not settings.quantized else COMPRESSIBLE if settings.compressed else FULL
            arranged = arrange_levels(level.document, found, precision, objects.material_names, objects.unlit, objects.armature_names)
            (folder / target.name).write_bytes(save_glb(arranged, settings.compressed))
        if settings.rebake_textures and not has_codecs:
            sentences.append("Images of levels keep their sizes, since this Python lacks the module Pillow.")
        lacking = objects.lacking
    return paths, [*sentences, *describe_lacking(lacking, "The .glb" if settings.one_file else "Each .glb")]


def _check_modules(settings: ExportSettings) -> bool:
    """Return whether images can be coded, which needs a module of Farfield's zip.

    Raises:
        SettingsError: settings that are off by default need a module that is missing.
    """
    needed = {"PIL": ("WebP", settings.webp, "webp"), "meshopt": ("Compressed", settings.compressed, "compressed")}
    for module, (label, is_on, name) in needed.items():
        if is_on and find_spec(module) is None:
            raise SettingsError(
                f"{label} needs the module {module}, which this Python lacks; turn it off, or install Farfield's zip.", settings=(name,)
            )
    return find_spec("PIL") is not None


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
            coverages = _coverages(levels) if others else ()
            nodes.append(
                LevelNode(source, f"{levels.label}_LOD{index}", bounds, _matrix(item), others, coverages, float(levels.errors[index]))
            )
    return nodes


def export_collection(collection: bpy.types.Collection, has_tangents: bool = False) -> Document:
    """Return the document of the file that Blender's exporter writes of a collection.

    has_tangents: whether vertices have tangents for the active UV map.

    Raises:
        FileError: it cannot write an image or the file.
    """
    layer = bpy.context.view_layer
    active = layer.objects.active
    with temporary_folder() as folder:
        path = folder / "levels.glb"
        layer.objects.active = None  # Or the exporter would leave its mode.
        try:
            export_gltf(path, {**OPTIONS, "collection": collection.name, "export_tangents": has_tangents})
        finally:
            layer.objects.active = active
        with convert_os_errors(f'Cannot read "{path}"'):
            content = path.read_bytes()
    return load_glb(content)


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
