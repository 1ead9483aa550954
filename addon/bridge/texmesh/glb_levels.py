"""Levels of a scene as .glb files: one per level, or one with all levels of each object (MSFT_lod and MSFT_screencoverage)."""

import re
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import GeometryError
from ...core.files.atomic_write import atomic_folder
from ...core.files.file_access import convert_os_errors
from ...core.files.glb import Y_UP, GlbMesh, GlbNode, GlbPrimitive, GlbScene, encode_glb, is_own_glb
from ...core.files.outputs import Output
from ...core.texmesh.perception.switch_distances import level_coverages
from ..geometry.evaluated_mesh import read_evaluated_mesh
from ..geometry.meshes import find_material
from ..objects import world_matrix
from .glb_materials import GlbMaterials, describe_unread
from .level_sets import LevelSet

NORMAL_STEPS = 1023.0  # normals of a vertex that are equal to 1/NORMAL_STEPS are one: Blender rounds them differently per corner


def write_levels(
    sets: Sequence[LevelSet], path: Path, is_quantized: bool = True, is_one_file: bool = False
) -> tuple[list[Path], list[str]]:
    """Write levels and return the files: `path` if it is one file, otherwise one per level next to it, see `level_path`. Also return
    sentences about what the files lack.

    File N has level N of every object, or its coarsest one. All files appear, or none.

    Raises:
        FileError: a file cannot be written, or an image cannot be read. GeometryError: an object has no triangles.
    """
    count = 1 if is_one_file else max(len(levels.levels) for levels in sets)
    paths = [path if is_one_file else level_path(path, number) for number in range(count)]
    unread: dict[str, tuple[str, ...]] = {}
    with atomic_folder(path.parent) as folder:
        for number, target in enumerate(paths):
            scene, lacking = build_scene(sets, None if is_one_file else number)
            (folder / target.name).write_bytes(encode_glb(scene, is_quantized))
            unread |= lacking
    return paths, describe_unread(unread, "The .glb" if is_one_file else "Each .glb")


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


def build_scene(sets: Sequence[LevelSet], number: int | None) -> tuple[GlbScene, dict[str, tuple[str, ...]]]:
    """Return the scene with the level `number` of each object, or its coarsest one, or with all if it is None: the finest one is replaced
    by the others as it covers less of the image. Also return what it lacks by material."""
    materials, nodes, meshes = GlbMaterials(), [], []
    for levels in sets:
        first, bounds = len(nodes), _bounds(levels)
        shown = levels.levels if number is None else [levels.levels[min(number, len(levels.levels) - 1)]]
        for index, item in enumerate(shown):
            others = () if index else tuple(range(first + 1, first + len(shown)))
            nodes.append(GlbNode(item.name, len(meshes), _matrix(item), others, _coverages(levels) if others else ()))
            meshes.append(GlbMesh(item.data.name, read_primitives(item, materials, levels.source_name), bounds))
    return GlbScene(tuple(nodes), tuple(meshes), tuple(materials.materials), tuple(materials.images)), materials.unread


def read_primitives(item: bpy.types.Object, materials: GlbMaterials, source_name: str) -> tuple[GlbPrimitive, ...]:
    """Return the triangles of an object by material, in its own space with y upwards, with normals, the UV map of the material and the
    vertex colors that it shows. Note what else it has under `source_name`.

    Raises:
        GeometryError: it has none, or is in Edit Mode. FileError: an image of a material cannot be read.
    """
    if item.data.is_editmode:
        raise GeometryError(f'"{item.name}" is in Edit Mode; leave it.')
    mesh = read_evaluated_mesh(item.data, item)
    if not len(mesh.triangles):
        raise GeometryError(f'"{item.name}" has no triangles to write; make its levels again.')
    normals = mesh.normals[mesh.loops].astype(np.float64)
    primitives, uses = [], []
    for index in np.unique(mesh.material_indices).tolist():
        rows = np.flatnonzero(mesh.material_indices == index)
        key = mesh.materials[index]
        material, use = materials.add(None if key is None else find_material(key))
        uvs, colors = use.read_uvs(mesh, rows), use.read_colors(mesh, rows)
        materials.note_uvs(material, uvs)
        uses.append(use)
        primitives.append(_join_corners(mesh.vertices, mesh.triangles[rows], normals[rows], uvs, colors, material))
    materials.note_attributes(source_name, item.data, uses)
    return tuple(primitives)


def _join_corners(
    vertices: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    uvs: np.ndarray | None,
    colors: np.ndarray | None,
    material: int | None,
) -> GlbPrimitive:
    """Return a primitive in which corners with the same vertex, normal, texture coordinates and color are one vertex."""
    columns = [triangles, np.rint(NORMAL_STEPS * normals), *(values for values in (uvs, colors) if values is not None)]
    rows = np.concatenate([values.reshape(triangles.size, -1) for values in columns], axis=1)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    positions = vertices[triangles.ravel()[first]].astype(np.float64) @ Y_UP.T
    return GlbPrimitive(
        positions,
        inverse.reshape(-1, 3).astype(np.int32),
        normals.reshape(-1, 3)[first] @ Y_UP.T,
        None if uvs is None else uvs.reshape(-1, 2)[first],
        None if colors is None else colors.reshape(triangles.size, -1)[first],
        material,
    )


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
