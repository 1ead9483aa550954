"""Levels of the objects of a scene, with whole materials: by Farfield, by Blender's Decimate, by gltfpack and by pymeshlab.

All start from the same objects. Decimate gets the evaluated mesh with all its attributes, gltfpack a .glb that Blender exports from it, and
pymeshlab an .obj. Objects that share their mesh are one: their levels are made once.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import texmesh_peers
from texmesh_renders import write_source

from farfield.addon.bridge.geometry.mesh_arrays import read_loop_triangles, read_positions, read_uvs, read_values
from farfield.addon.bridge.lod_sets import set_hidden
from farfield.addon.bridge.objects import world_matrix
from farfield.addon.bridge.texmesh.level_sets import LevelSet, read_level_set
from farfield.addon.bridge.texmesh.sources import TexturedSource
from farfield.addon.core.errors import FarfieldError, GeometryError
from farfield.addon.core.geometry.transforms import transform_points
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.settings import SceneSettings, TexmeshSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.texmesh.job import prepare_levels
from lib.demo_materials import create_material

PLACEHOLDER = "Farfield Placeholder"  # an image
PREFIX = "material_"  # A material that stands for one of an object has the number of its slot after it.


@dataclass
class Asset:
    """An object of a scene, and its levels.

    Attributes:
        item, users: the object, and all objects that share its mesh.
        mesh: a copy of its evaluated mesh.
        source: what Farfield reads of it, None if it cannot.
        triangles: their number, without those that have no area, which Farfield does not count.
        levels: by method and ratio.
        surfaces: of `levels`, in world space, by method and ratio.
        failures: by method and ratio, why there is no level.
    """

    item: bpy.types.Object
    users: list[bpy.types.Object]
    mesh: bpy.types.Mesh
    source: TexturedSource | None = None
    triangles: int = 0
    levels: dict[tuple[str, float], bpy.types.Mesh] = field(default_factory=dict)
    surfaces: dict[tuple[str, float], TexturedMesh] = field(default_factory=dict)
    failures: dict[tuple[str, float], str] = field(default_factory=dict)

    @property
    def uv_map(self) -> str:
        """The UV map that counts, "" for none."""
        return "" if self.source is None else self.source.uv_map

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4) to world space."""
        return np.array(world_matrix(self.item), np.float64)

    def read(self, mesh: bpy.types.Mesh) -> TexturedMesh:
        """Return the triangles of a level, in world space."""
        return read_surface(mesh, self.uv_map, self.matrix)


def find_assets(objects: Sequence[bpy.types.Object], min_triangles: int) -> list[Asset]:
    """Return the objects with enough triangles, those that share their mesh as one."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    groups: dict[Any, list[bpy.types.Object]] = {}
    for item in objects:
        groups.setdefault(item.name if item.modifiers or item.type != "MESH" else item.data, []).append(item)
    assets = []
    for users in groups.values():
        evaluated = users[0].evaluated_get(depsgraph)
        mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
        mesh.calc_loop_triangles()
        if len(mesh.loop_triangles) >= min_triangles:
            assets.append(Asset(users[0], users, mesh, triangles=len(mesh.loop_triangles)))
    return assets


def find_points(assets: Sequence[Asset]) -> np.ndarray:
    """Return the vertices (N, 3) of all objects in world space."""
    return np.concatenate(
        [transform_points(np.array(world_matrix(user)), read_positions(asset.mesh)) for asset in assets for user in asset.users]
    )


def read_surface(mesh: bpy.types.Mesh, uv_map: str, matrix: np.ndarray) -> TexturedMesh:
    """Return the triangles of a Blender mesh in the space of `matrix` (4, 4), each with corners of its own. materials: of its slots."""
    loops, polygons = read_loop_triangles(mesh)
    triangles = read_values(mesh.loop_triangles, "vertices", 3, np.int32)
    layer = mesh.uv_layers.get(uv_map) if uv_map else None
    uvs = np.zeros((loops.size, 2)) if layer is None else read_uvs(layer)[loops.ravel()].astype(np.float64)
    corners = np.arange(loops.size, dtype=np.int32)
    return TexturedMesh(
        vertices=transform_points(matrix, read_positions(mesh)[triangles.ravel()]),
        triangles=corners.reshape(-1, 3),
        wedge_triangles=corners.reshape(-1, 3),
        wedge_vertices=corners,
        uvs=uvs,
        attributes=np.zeros((loops.size, 0), np.float32),
        materials=read_values(mesh.polygons, "material_index", dtype=np.int32)[polygons],
        sources=corners.reshape(-1, 3),
    )


def add_farfield_levels(assets: Sequence[Asset], ratios: Sequence[float]) -> str:
    """Make levels of all objects as the script and the panel do, with default settings. Return its result in one line, or its error."""
    settings = TexmeshSettings(levels="ratios", ratios=",".join(f"{ratio:g}" for ratio in ratios))
    by_name = {asset.item.name: asset for asset in assets}
    job = prepare_levels(bpy.context, [asset.item for asset in assets], settings, SceneSettings(cross_fade=False))
    for source, placement in job.placed:
        asset = by_name[placement.name]
        asset.source, asset.triangles = source, len(source.mesh.triangles)
    try:
        summary = run_to_end(run_job(job))
    except FarfieldError as error:
        for asset in assets:
            asset.failures.update({("farfield", ratio): str(error) for ratio in ratios})
        return str(error)
    for (source, placement), name in zip(job.placed, job.chains, strict=True):
        asset = by_name[placement.name]
        meshes = _evaluate_levels(read_level_set(bpy.data.collections[name]))
        counts = np.array([len(mesh.polygons) for mesh in meshes])
        for ratio in ratios:
            target = max(ratio * asset.triangles, 1.0)
            mesh = meshes[int(np.abs(np.log(np.maximum(counts, 1) / target)).argmin())]
            add_level(asset, "farfield", ratio, restore_materials(asset, mesh, _find_slots(asset, source)))
    return summary


def _evaluate_levels(levels: LevelSet) -> list[bpy.types.Mesh]:
    """Return the meshes of levels, in the pose of their armature."""
    for item in levels.levels:
        set_hidden(item, False)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return [
        bpy.data.meshes.new_from_object(item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph)
        for item in levels.levels
    ]


def _find_slots(asset: Asset, source: TexturedSource) -> list[int]:
    """Return the slots of the object that the materials of a source come from."""
    names = [None if material is None else material.name for material in asset.mesh.materials]
    return [names.index(name) if name in names else 0 for name in (None if key is None else key[0] for key in source.evaluated.materials)]


def restore_materials(asset: Asset, mesh: bpy.types.Mesh, slots: Sequence[int]) -> bpy.types.Mesh:
    """Return a copy of `mesh` with the materials of the object. slots: of the object, by slot of `mesh`."""
    copy = mesh.copy()
    indices = read_values(copy.polygons, "material_index", dtype=np.int32)
    copy.materials.clear()
    for material in asset.mesh.materials:
        copy.materials.append(material)
    table = np.array([*slots] or [0], np.int32)
    copy.polygons.foreach_set("material_index", table[np.clip(indices, 0, len(table) - 1)])
    return copy


def add_level(asset: Asset, method: str, ratio: float, mesh: bpy.types.Mesh) -> None:
    """Store the level of a method, and its surface, unless nothing is left of the object."""
    if not len(mesh.polygons):
        asset.failures[method, ratio] = "no triangle is left"
        return
    asset.levels[method, ratio] = mesh
    asset.surfaces[method, ratio] = asset.read(mesh)


def add_peer_levels(asset: Asset, ratios: Sequence[float]) -> None:
    """Make levels of an object by all other programs."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        glb = export_glb(asset, folder)
        obj = None if asset.source is None else write_source(asset.source.mesh, folder)
        for ratio in ratios:
            count = max(round(ratio * asset.triangles), 1)
            fraction = count / len(asset.mesh.loop_triangles)
            add_level(asset, "decimate", ratio, decimate(asset.mesh, fraction))
            packed = texmesh_peers.run_gltfpack(glb, folder, fraction, import_glb)
            if packed.mesh is None:
                asset.failures["gltfpack", ratio] = packed.message
            else:
                add_level(asset, "gltfpack", ratio, _read_packed(asset, packed.mesh))
            if obj is not None:
                method = texmesh_peers.MESHLAB_TEXTURED if asset.uv_map else texmesh_peers.MESHLAB_PLAIN
                _add_meshlab(asset, ratio, texmesh_peers.simplify_with_meshlab(obj, folder, count, method=method))


def _read_packed(asset: Asset, mesh: bpy.types.Mesh) -> bpy.types.Mesh:
    """Return the mesh of an imported .glb with the materials and the names of UV maps of the object."""
    slots = [int(material.name.removeprefix(PREFIX).split(".")[0]) for material in mesh.materials]
    result = restore_materials(asset, mesh, slots)
    for layer, name in zip(list(result.uv_layers), order_uv_maps(asset.mesh), strict=False):
        layer.name = name
    return result


def _add_meshlab(asset: Asset, ratio: float, level: texmesh_peers.PeerLevel) -> None:
    if level.mesh is None:
        asset.failures["pymeshlab", ratio] = level.message
    else:
        mesh: TexturedMesh = level.mesh
        matrix, slots = asset.matrix, np.array(_find_slots(asset, asset.source), np.int32)
        corners = mesh.triangles.ravel()
        numbers = np.arange(corners.size, dtype=np.int32)
        asset.surfaces["pymeshlab", ratio] = TexturedMesh(
            transform_points(matrix, mesh.vertices[corners] + asset.source.origin),
            numbers.reshape(-1, 3),
            numbers.reshape(-1, 3),
            numbers,
            mesh.corner_uvs.reshape(-1, 2),
            np.zeros((corners.size, 0), np.float32),
            slots[mesh.materials],
            mesh.sources,
        )


def decimate(mesh: bpy.types.Mesh, ratio: float) -> bpy.types.Mesh:
    """Simplify with the modifier Decimate, mode Collapse."""

    def modify(item: bpy.types.Object) -> bpy.types.Mesh:
        modifier = item.modifiers.new("Decimate", "DECIMATE")
        modifier.ratio, modifier.use_collapse_triangulate = ratio, True
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return bpy.data.meshes.new_from_object(item.evaluated_get(depsgraph), preserve_all_data_layers=True, depsgraph=depsgraph)

    return _with_object(mesh, modify)


def export_glb(asset: Asset, folder: Path) -> Path:
    """Export an object as Blender does, with a small image as the material of each slot, and return the path. A mesh that is shaded flat
    everywhere gets no normals, which would disconnect its triangles."""
    mesh, path = asset.mesh.copy(), folder / "source.glb"
    options = {"export_animations": False, "export_normals": mesh.normals_domain != "FACE"}
    placeholders = [_create_placeholder(slot) for slot in range(max(len(mesh.materials), 1))]
    for slot, material in enumerate(placeholders):
        if slot < len(mesh.materials):
            mesh.materials[slot] = material
        else:
            mesh.materials.append(material)

    def export(item: bpy.types.Object) -> None:
        for other in bpy.context.view_layer.objects:
            other.select_set(other == item)
        bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLB", use_selection=True, **options)

    _with_object(mesh, export)
    bpy.data.meshes.remove(mesh)
    bpy.data.batch_remove(placeholders)
    return path


def _create_placeholder(slot: int) -> bpy.types.Material:
    material, nodes, links, surface = create_material(f"{PREFIX}{slot}")
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.get(PLACEHOLDER) or bpy.data.images.new(PLACEHOLDER, 4, 4)
    links.new(texture.outputs["Color"], surface.inputs["Base Color"])
    return material


def _with_object(mesh: bpy.types.Mesh, use: Callable[[bpy.types.Object], Any]) -> Any:
    """Return what `use` returns of a temporary object of `mesh` in the scene."""
    item = bpy.data.objects.new("peer", mesh)
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    try:
        return use(item)
    finally:
        bpy.data.objects.remove(item)


def import_glb(path: Path) -> bpy.types.Mesh:
    """Import a .glb and return its objects as one mesh. Raises GeometryError if it has none."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path))
    added = [item for item in bpy.data.objects if item not in before]
    meshes = [item for item in added if item.type == "MESH"]
    if len(meshes) > 1:
        with bpy.context.temp_override(active_object=meshes[0], selected_editable_objects=meshes):
            bpy.ops.object.join()
    if not meshes:
        raise GeometryError(f'"{path.name}" has no triangles; choose another model.')
    mesh = meshes[0].data
    bpy.data.batch_remove([item for item in bpy.data.objects if item not in before])
    return mesh


def order_uv_maps(mesh: bpy.types.Mesh) -> list[str]:
    """Return the names of UV maps in the order in which Blender exports them: first the one that renders."""
    return [layer.name for layer in sorted(mesh.uv_layers, key=lambda layer: not layer.active_render)]
