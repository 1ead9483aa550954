"""A billboard cloud as Blender objects: a collection with one mesh of textured quads a level."""

import math
from collections.abc import Sequence

import bpy
import numpy as np

from ..core.billboards.cloud import Cloud, Level
from ..core.cameras import Camera
from ..core.images import EMPTY, dilate, unpremultiply
from ..core.metrics import encode_srgb
from .cameras import scene_camera
from .cloud_materials import JOINED_ATTRIBUTE, SOLID_ATTRIBUTE, cloud_material, grey_material
from .images import data_image, packed_bytes
from .meshes import Source
from .quad_normals import corner_normals
from .slots import slots_of, texture_coordinates
from .textures import LevelTextures, Maps

KIND, CLOUD = "farfield_kind", "cloud"  # on all that Farfield makes, and what it says on the levels of a cloud
FINGERPRINT = "farfield_source_fingerprint"  # on a cloud's collection, see `Source.fingerprint`
CORNER_NORMALS = "custom_normal"  # Blender's own name for normals of corners that are set by hand
DRAWN_OFFSETS, DRAWN = "farfield_drawn_offsets", "farfield_drawn"  # on a level's mesh
SHADOWLESS_ERRORS = 4.0  # quads cast no shadow upon what is nearer than so many errors: they stand for one surface and overlap within that


def make_cloud(
    cloud: Cloud, textures: list[LevelTextures] | None, source: Source, collection_parent: bpy.types.Collection
) -> bpy.types.Collection:
    """A collection "<name> Cloud" below `collection_parent` with one object a level, finest first; only that one is visible.

    The objects stand at the source's origin without rotation or scale. Each carries farfield_kind ("cloud"), farfield_level,
    farfield_error (a length), farfield_switch_distance (for the camera of the first scene that holds the parent, else of an ordinary one;
    inf for an orthographic camera that shows the error), farfield_quads, farfield_texels and farfield_texture_bytes. Without `textures`
    they are grey.
    """
    collection = bpy.data.collections.new(f"{source.name} Cloud")
    camera = _camera(collection_parent)
    for number, level in enumerate(cloud.levels):
        name = f"{collection.name} L{number}"
        material = grey_material(name) if textures is None else _textured_material(name, level, textures[number])
        level_object = bpy.data.objects.new(name, _mesh(name, level, None if textures is None else textures[number].front, source.origin))
        level_object.location = source.origin
        level_object.data.materials.append(material)
        _describe(level_object, number, level, camera, material)
        _remember_drawn(level_object.data, level)
        level_object.hide_viewport = level_object.hide_render = number > 0
        collection.objects.link(level_object)
    collection[FINGERPRINT] = source.fingerprint
    collection_parent.children.link(collection)
    return collection


def _remember_drawn(mesh: bpy.types.Mesh, level: Level) -> None:
    """Keep which faces of the source each quad shows: what bakes later textures for the quads needs it."""
    mesh[DRAWN_OFFSETS], mesh[DRAWN] = level.quads.drawn_offsets.tolist(), level.quads.drawn.tolist()


def drawn_on(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The starts (Q + 1,) and the faces of the source that the quads of a level's mesh show, see `Quads`."""
    return np.array(mesh[DRAWN_OFFSETS], np.int64), np.array(mesh[DRAWN], np.int64)


def needed_transparent_bounces(levels: Sequence[bpy.types.Object], together: bool = False) -> int:
    """Transparent bounces with which Cycles shows quads behind quads without turning dark: 32 to 1024, Cycles' limit.

    An estimate: four times the mean number of quads that a line through the bounding sphere meets in the level where that is most, or in
    all levels where they are shown `together`.
    """
    stacked = []
    for level in levels:
        places = np.empty(3 * len(level.data.vertices), np.float32)
        level.data.vertices.foreach_get("co", places)
        longest = float(np.ptp(places.reshape(-1, 3), axis=0).max())
        stacked.append(4.0 * sum(polygon.area for polygon in level.data.polygons) / (0.25 * math.pi * longest**2))
    return int(min(max(32.0, sum(stacked) if together else max(stacked)), 1024.0))


def allow_transparent_bounces(scene: bpy.types.Scene, bounces: int) -> None:
    """Let light through so many transparent quads behind each other: Cycles draws what lies deeper black. What allows more stays."""
    if hasattr(scene, "cycles"):
        scene.cycles.transparent_max_bounces = max(scene.cycles.transparent_max_bounces, bounces)


def _camera(parent: bpy.types.Collection) -> Camera:
    """The camera whose pixels the levels are measured by."""
    for scene in bpy.data.scenes:
        if parent == scene.collection or parent in scene.collection.children_recursive:
            camera = scene_camera(scene)
            if camera is not None:
                return camera
    return Camera(np.zeros(3), 1920, math.radians(39.6))


def _describe(level_object: bpy.types.Object, number: int, level: Level, camera: Camera, material: bpy.types.Material) -> None:
    level_object[KIND] = CLOUD
    level_object["farfield_level"] = number
    level_object["farfield_error"] = float(level.error)
    level_object["farfield_switch_distance"] = float(camera.switch_distance(level.error))
    level_object["farfield_quads"] = len(level.quads)
    level_object["farfield_texels"] = level.texels
    level_object["farfield_atlas"] = list(level.atlas.size)
    images = [node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE"] if material.node_tree else []
    level_object["farfield_texture_bytes"] = sum(packed_bytes(image) for image in images)


def _mesh(name: str, level: Level, maps: Maps | None, origin: np.ndarray) -> bpy.types.Mesh:
    """The quads of `level`, each cut to its polygon, with UVs and the normals that `maps` suggest; vertices relative to `origin`."""
    quads, slots = level.quads, slots_of(level)
    positions, uvs, normals = [], [], []
    for quad, cutout in enumerate(level.cutouts):
        flat = cutout * quads.half_sizes[quad]
        positions.append(quads.centers[quad] - origin + flat @ quads.frames[quad, :2])
        uvs.append(texture_coordinates(level, slots, quad, cutout))
        if maps is not None:
            normals.append(corner_normals(level, maps, quad, cutout))
    corners = np.array([len(cutout) for cutout in level.cutouts])
    count = int(corners.sum())
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(count)
    mesh.loops.add(count)
    mesh.polygons.add(len(corners))
    mesh.vertices.foreach_set("co", np.concatenate(positions).astype(np.float32).ravel())
    mesh.loops.foreach_set("vertex_index", np.arange(count, dtype=np.int32))
    mesh.polygons.foreach_set("loop_start", (np.cumsum(corners) - corners).astype(np.int32))
    mesh.update(calc_edges=True)
    if maps is not None:
        free_normals = mesh.attributes.new(CORNER_NORMALS, "FLOAT_VECTOR", "POINT")
        free_normals.data.foreach_set("vector", np.concatenate(normals).astype(np.float32).ravel())
    for attribute, flags in ((SOLID_ATTRIBUTE, level.solid), (JOINED_ATTRIBUTE, level.joined)):
        mesh.attributes.new(attribute, "FLOAT", "FACE").data.foreach_set("value", flags.astype(np.float32))
    layer = mesh.attributes.new("UVMap", "FLOAT2", "CORNER")
    layer.data.foreach_set("vector", np.concatenate(uvs).astype(np.float32).ravel())
    return mesh


def _textured_material(name: str, level: Level, textures: LevelTextures) -> bpy.types.Material:
    images = {}
    for side, maps in (("Front", textures.front), ("Back", textures.back)):
        for map_name, pixels in _encoded(maps, level.atlas.gutter).items():
            images[side, map_name] = data_image(f"{name} {side} {map_name}", pixels, is_data=map_name != "Colour")
    return cloud_material(name, images, SHADOWLESS_ERRORS * level.error)


def _encoded(maps: Maps, gutter: int) -> dict[str, np.ndarray]:
    """The maps of one side as 8-bit images hold them: (H, W, 4) in 0..1."""
    straight = unpremultiply(maps.colour)
    alpha = np.clip(straight[..., 3:], 0.0, 1.0)
    colour = dilate(straight[..., :3], maps.colour[..., 3] * (maps.colour[..., 3] > EMPTY), gutter // 2 + 1)
    surface = maps.surface * np.float32([1.0, 1.0, 0.5]) + np.float32([0.0, 0.0, 0.5])
    opaque = np.ones_like(alpha)
    return {
        "Colour": np.concatenate([encode_srgb(colour), alpha], axis=2),
        "Normal": np.concatenate([0.5 + 0.5 * maps.normal, opaque], axis=2),
        "Surface": np.concatenate([surface, opaque], axis=2),
    }
