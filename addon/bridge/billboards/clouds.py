"""A billboard cloud as Blender objects: a collection with one mesh of textured quads per level."""

import math
from collections.abc import Sequence

import bpy
import numpy as np

from ...core.billboards.cloud import Cloud, Level
from ...core.geometry.cameras import Camera
from ..blender import remove_unused_data
from ..cameras import read_scene_camera
from ..geometry.mesh_arrays import read_positions, write_attribute, write_geometry, write_integers
from ..geometry.meshes import Source
from ..imaging.images import packed_bytes
from ..lod_sets import KIND
from .atlas_meshes import compute_placement, compute_uvs
from .cloud_materials import JOINED_ATTRIBUTE, SOLID_ATTRIBUTE, create_gray_material
from .level_maps import LevelTextures, PbrMaps, compute_corner_normals, create_textured_material
from .level_objects import CENTER, QUAD_ATTRIBUTE

CLOUD = "cloud"  # the KIND of levels
FINGERPRINT = "farfield_source_fingerprint"  # Custom property of a cloud's collection, see `Source.fingerprint`.
MESH_TRIANGLES = "farfield_mesh_triangles"  # Custom property of a level: triangles in decimated meshes; older levels lack it.
NOTES = "farfield_notes"  # Custom property of a cloud's collection: sentences about its levels, see `Cloud.notes`.
CORNER_NORMALS = "custom_normal"  # Blender's built-in attribute of custom normals.
DRAWN_OFFSETS, DRAWN = "farfield_drawn_offsets", "farfield_drawn"  # Custom properties of a level's mesh, see `cloud.Quads`.
DEFAULT_CAMERA = Camera(np.zeros(3), 1920, math.radians(39.6))  # Blender's default, for scenes without a camera.


def create_cloud(
    cloud: Cloud, textures: list[LevelTextures] | None, source: Source, collection_parent: bpy.types.Collection
) -> bpy.types.Collection:
    """Create the collection of a cloud in `collection_parent`, see `build_collection`."""
    collection = build_collection(cloud, textures, source, collection_parent)
    collection_parent.children.link(collection)
    return collection


def build_collection(
    cloud: Cloud, textures: list[LevelTextures] | None, source: Source, future_parent: bpy.types.Collection
) -> bpy.types.Collection:
    """Return a new collection "<name> Cloud" with one object per level, finest first; only that one is visible. It is in no scene.

    The objects are located at the source's origin, without rotation or scale. Their custom properties are farfield_kind ("cloud"),
    farfield_level, farfield_error (a length), farfield_switch_distance (for the active camera of the first scene that contains the
    `future_parent`, otherwise for Blender's default camera; inf for an orthographic camera that shows the error), farfield_mesh_triangles,
    farfield_quads, farfield_texels, farfield_atlas, farfield_center and farfield_texture_bytes. Without `textures` the material is gray.
    """
    collection = bpy.data.collections.new(f"{source.name} Cloud")
    camera = _find_camera(future_parent)
    for index, level in enumerate(cloud.levels):
        name = f"{collection.name} L{index}"
        level_object = create_level_object(name, level, None if textures is None else textures[index], source.origin)
        mesh = level_object.data
        _write_properties(level_object, index, level, camera, mesh.materials[0])
        level_object[CENTER] = (read_positions(mesh).astype(np.float64).mean(axis=0) + source.origin).tolist()
        mesh[DRAWN_OFFSETS], mesh[DRAWN] = level.quads.drawn_offsets.tolist(), level.quads.drawn.tolist()  # Later bakes need them.
        level_object.hide_viewport = level_object.hide_render = index > 0
        collection.objects.link(level_object)
    collection[FINGERPRINT] = source.fingerprint
    write_notes(collection, cloud.notes)
    return collection


def create_level_object(name: str, level: Level, textures: LevelTextures | None, origin: np.ndarray) -> bpy.types.Object:
    """Create the object of a level at `origin` (3,), with the quads of its mesh relative to that. Without `textures` it is gray."""
    material = create_gray_material(name) if textures is None else create_textured_material(name, level, textures)
    level_object = bpy.data.objects.new(name, _create_mesh(name, level, None if textures is None else textures.front, origin))
    level_object.location = origin
    level_object.data.materials.append(material)
    return level_object


def list_level_data(level_object: bpy.types.Object) -> list[bpy.types.ID]:
    """Return what `create_level_object` has created: images, material, mesh and object, but not the node groups that clouds share."""
    material = level_object.data.materials[0]
    images = dict.fromkeys(node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE") if material.node_tree else ()
    return [*images, material, level_object.data, level_object]


def write_notes(collection: bpy.types.Collection, notes: Sequence[str]) -> None:
    """Store sentences about a cloud for its panel."""
    if notes:
        collection[NOTES] = "\n".join(notes)


def discard_collection(collection: bpy.types.Collection) -> None:
    """Remove a collection that is in no scene, with its levels and their meshes, materials and images, and node groups that nothing else
    uses."""
    owned = [data for level in collection.objects for data in list_level_data(level)]
    groups = {
        node.node_tree
        for data in owned
        if isinstance(data, bpy.types.Material) and data.node_tree
        for node in data.node_tree.nodes
        if node.type == "GROUP"
    }
    bpy.data.batch_remove([*owned, collection])
    remove_unused_data(groups)


def read_drawn_primitives(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the offsets (Q + 1,) and the primitives (K,) of the source that the quads of a level's mesh show, see `cloud.Quads`."""
    return np.array(mesh[DRAWN_OFFSETS], np.int64), np.array(mesh[DRAWN], np.int64)


def _find_camera(parent: bpy.types.Collection) -> Camera:
    """Return the camera for which switch distances are computed."""
    for scene in bpy.data.scenes:
        if parent == scene.collection or parent in scene.collection.children_recursive:
            camera = read_scene_camera(scene)
            if camera is not None:
                return camera
    return DEFAULT_CAMERA


def _write_properties(level_object: bpy.types.Object, index: int, level: Level, camera: Camera, material: bpy.types.Material) -> None:
    level_object[KIND] = CLOUD
    level_object["farfield_level"] = index
    level_object["farfield_error"] = float(level.error)
    level_object["farfield_switch_distance"] = float(camera.switch_distance(level.error))
    level_object[MESH_TRIANGLES] = level.chart_triangle_count
    level_object["farfield_quads"] = len(level.quads)
    level_object["farfield_texels"] = level.texel_count
    level_object["farfield_atlas"] = list(level.atlas.size)
    images = [node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE"] if material.node_tree else []
    level_object["farfield_texture_bytes"] = sum(packed_bytes(image) for image in images)


def _create_mesh(name: str, level: Level, maps: PbrMaps | None, origin: np.ndarray) -> bpy.types.Mesh:
    """Create the quads of `level`, cut to their polygons, with UVs and corner normals fitted to `maps`; vertices relative to `origin`."""
    quads, placement = level.quads, compute_placement(level)
    positions, uvs, normals, faces = [], [], [], []
    for quad, (cutout, chart) in enumerate(zip(level.cutouts, level.charts, strict=True)):
        if chart is not None:
            cutout = level.to_cutout(quad, chart.vertices)
            positions.append(chart.vertices - origin)
            normals.append(chart.normals)
            faces.append(chart.triangles)
        else:
            positions.append(quads.centers[quad] - origin + (cutout * quads.half_sizes[quad]) @ quads.frames[quad, :2])
            normals.append(None if maps is None else compute_corner_normals(level, maps, quad, cutout))
            faces.append(np.arange(len(cutout))[None])
        uvs.append(compute_uvs(level, placement, quad, cutout))
    first = np.cumsum([0] + [len(vertices) for vertices in positions])
    loops = np.concatenate([(polygons + start).ravel() for polygons, start in zip(faces, first[:-1], strict=True)])
    face_counts = [len(polygons) for polygons in faces]
    corners = np.repeat([polygons.shape[1] for polygons in faces], face_counts)
    mesh = bpy.data.meshes.new(name)
    write_geometry(mesh, np.concatenate(positions), loops, np.cumsum(corners) - corners)
    if maps is not None:
        write_attribute(mesh, CORNER_NORMALS, "POINT", np.concatenate(normals))
    quad_of_face = np.repeat(np.arange(len(faces)), face_counts)
    for attribute, flags in ((SOLID_ATTRIBUTE, level.solid), (JOINED_ATTRIBUTE, level.joined)):
        write_attribute(mesh, attribute, "FACE", flags[quad_of_face])
    write_attribute(mesh, "UVMap", "CORNER", np.concatenate(uvs)[loops])
    if len(quad_of_face) > len(faces):
        write_integers(mesh, QUAD_ATTRIBUTE, "FACE", quad_of_face)
    return mesh
