"""Ordinary assets for `bench_texmesh.py --only ordinary`, opened as scenes with whole materials: files, and four generated ones.

Generated ones have the defects of assets that people make: many parts with mirrored texture coordinates, islands of a few triangles,
repeated texture coordinates with several materials, and an armature.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import bpy
import mathutils
import numpy as np
from texmesh_chains import paint
from texmesh_models import grid_uvs, join_patches, make_bumps, place_island

from farfield.addon.bridge.geometry.mesh_arrays import write_triangles, write_uvs
from farfield.addon.bridge.imaging.images import create_image
from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh
from lib import scene_files
from lib.demo_materials import create_material

TUNING = {"truck": "hard_surface/CesiumMilkTruck.glb", "fuze": "hard_surface/fuze.obj", "spot": "textured/spot/spot.obj"}
JUDGING = {
    "tray": "hard_surface/1002_tray_bottom.STL",
    "sensor": "hard_surface/ADIS16480.STL",
    "capsule": "hard_surface/capsule.obj",
    "chair": "hard_surface/chair_model.obj",
    "cycloidal": "hard_surface/cycloidal.ply",
    "fandisk": "hard_surface/fandisk.obj",
    "featuretype": "hard_surface/featuretype.STL",
    "riser": "hard_surface/idler_riser.STL",
    "alpha_modes": "ordinary/alpha_blend_mode_test.glb",
    "rabbit": "ordinary/animals/Bunny.gltf",
    "stag": "ordinary/animals/Stag.gltf",
    "castle": "ordinary/castle/castle.gltf",
    "chopper": "ordinary/chopper/chopper.gltf",
    "fox": "ordinary/fox.glb",
    "knight": "ordinary/knight/knight_size_test.glb",
    "pumpkin_knight": "ordinary/pumpkin_knight/scene.gltf",
    "sheen_chair": "ordinary/sheen_chair/MixedLightingExample.gltf",
    "engine": "ordinary/two_cylinder_engine.glb",
}
IMAGE_SIDE = 512  # pixels of generated images
SHARP_ANGLE = np.radians(35.0)  # between faces at hard edges
Generated = TypeVar("Generated")
Patch = tuple[np.ndarray, np.ndarray, int]  # positions (R, C, 3) and texture coordinates (R, C, 2) of a grid, and its material


def open_asset(data: Path, name: str, seed: int) -> list[bpy.types.Object]:
    """Replace the scene by a model, one of TUNING, JUDGING and GENERATORS, and return its objects. Characters are at rest, as Farfield
    makes their levels."""
    path = TUNING.get(name) or JUDGING.get(name)
    if path is not None:
        scene_files.open_scene(data / path)
        objects = scene_files.objects_in_renders(data / path)
    else:
        objects = [generate(GENERATORS, name, seed)]
    for armature in bpy.data.armatures:
        armature.pose_position = "REST"
    bpy.context.view_layer.update()
    return objects


def generate(generators: dict[str, Callable[[np.random.Generator], Generated]], name: str, seed: int) -> Generated:
    """Return what the generator of this name adds to an empty scene, with random numbers that depend on its name and the seed."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return generators[name](np.random.default_rng([seed, list(generators).index(name)]))


def build_streetlight(generator: np.random.Generator) -> bpy.types.Object:
    """Return a streetlight of 40 parts: 8 on its axis, whose halves are mirrored, and 16 on each side, which are mirrored."""
    patches, islands = [], 24
    heights = np.cumsum(generator.uniform(0.2, 0.8, 9))
    for index in range(8):
        half = lathe(generator, (12, 14), (heights[index], heights[index + 1]), generator.uniform(0.05, 0.22), (0.0, np.pi))
        half[:, [0, -1]] *= [0.0, 0.0, 1.0]
        half[[0, -1], :, 1] = 0.0
        patches += _mirror(half, place_island(grid_uvs(half.shape[:2]), index, islands, generator), axis=1)
    for index in range(16):
        along = index / 15.0
        center = np.array([0.35 + 1.1 * along, 0.0, heights[-1] + 0.6 * np.sin(np.pi * along) - 0.3])
        size = generator.uniform(0.05, 0.3)
        part = lathe(generator, (14, 8), (-size, size), generator.uniform(0.04, 0.16), (0.0, 2.0 * np.pi))
        part[-1] = part[0]
        part = part @ _random_rotation(generator) + center
        patches += _mirror(part, place_island(grid_uvs(part.shape[:2]), 8 + index, islands, generator), axis=0)
    return add_object("streetlight", _join(patches), generator)


def build_crate(generator: np.random.Generator) -> bpy.types.Object:
    """Return a dented crate of 12 beams and 30 planks, each face of which is a UV island: 252 islands."""
    boxes = []
    for axis in range(3):
        for first in (-1.0, 1.0):
            for second in (-1.0, 1.0):
                boxes.append((np.roll([0.0, first, second], axis), np.roll([0.86, 0.1, 0.1], axis)))
            for plank in range(5):
                boxes.append((np.roll([first, 0.34 * (plank - 2), 0.0], axis), np.roll([0.04, 0.155, 0.8], axis)))
    bump, patches = make_bumps(generator), []
    for center, half in boxes:
        size = np.maximum(np.rint(6.0 * half), 2).astype(int)
        for face in _box(center + generator.normal(scale=0.003, size=3), half, size):
            dented = face + 0.08 * (bump(face) - face)
            patches.append((dented, place_island(grid_uvs(face.shape[:2]), len(patches), 6 * len(boxes), generator), 0))
    return add_object("crate", _join(patches), generator)


def build_terrace(generator: np.random.Generator) -> bpy.types.Object:
    """Return five terraced houses of four materials: brick, tile and wood repeat their images; all windows show the same one."""
    brick, tile, glass, wood = range(4)
    patches: list[Patch] = []
    for house in range(5):
        origin = np.array([1.2 * house, 0.0, generator.uniform(-0.15, 0.15)])
        height, depth, ridge = generator.uniform(1.6, 2.1), 1.4, generator.uniform(0.5, 0.8)
        for center, half, repeats, material in (
            ((0.6, 0.5 * depth, 0.5 * height), (0.59, 0.5 * depth, 0.5 * height), 4.0, brick),
            ((0.9, 0.5 * depth, height + ridge), (0.12, 0.15, 0.5), 1.0, brick),
            ((0.25, 0.0, 0.4), (0.15, 0.05, 0.4), 1.0, wood),
            *(((x, 0.0, z), (0.14, 0.04, 0.2), 1.0, glass) for x in (0.75, 1.0) for z in (0.6, 1.3)),
        ):
            size = np.clip(np.rint(16.0 * np.array(half)), 2, 12).astype(int)
            patches += [
                (face, repeats * grid_uvs(face.shape[:2]), material) for face in _box(origin + np.array(center), np.array(half), size)
            ]
        for side in (-1.0, 1.0):
            across, up = np.meshgrid(np.linspace(-0.02, 1.22, 25), np.linspace(0.0, 1.0, 13), indexing="ij")
            wave = 0.015 * np.sin(40.0 * up) + 0.01 * np.sin(30.0 * across + generator.uniform(0.0, 6.0))
            plane = np.stack([across, 0.5 * depth * (1.0 + side * (1.1 - 1.1 * up)), height + ridge * up + wave], axis=2)
            plane = plane[::-1] if side > 0.0 else plane
            patches.append((origin + plane, 6.0 * grid_uvs(plane.shape[:2]), tile))
    return add_object("terrace", _join(patches), generator)


def build_body(generator: np.random.Generator) -> bpy.types.Object:
    """Return a character of ten limbs with three islands each, posed by an armature with a bone per limb."""
    limbs = (  # ends of the axis, and the radius
        ((0.0, 0.0, 0.9), (0.0, 0.0, 1.5), 0.2),
        ((0.0, 0.0, 1.5), (0.0, 0.0, 1.85), 0.13),
        *(((side * 0.2, 0.0, 1.4), (side * 0.5, 0.0, 1.35), 0.08) for side in (-1.0, 1.0)),
        *(((side * 0.5, 0.0, 1.35), (side * 0.8, -0.05, 1.3), 0.06) for side in (-1.0, 1.0)),
        *(((side * 0.1, 0.0, 0.92), (side * 0.12, 0.02, 0.5), 0.11) for side in (-1.0, 1.0)),
        *(((side * 0.12, 0.02, 0.5), (side * 0.13, 0.0, 0.02), 0.08) for side in (-1.0, 1.0)),
    )
    patches: list[Patch] = []
    for index, (start, end, radius) in enumerate(limbs):
        axis = np.array(end) - start
        length = float(np.linalg.norm(axis))
        rotation = np.array(mathutils.Vector((0.0, 0.0, 1.0)).rotation_difference(mathutils.Vector(axis)).to_matrix())
        tube = lathe(generator, (36, 16), (-0.1 * length, 1.1 * length), radius, (0.0, 2.0 * np.pi))
        tube[-1] = tube[0]
        bumpy = tube @ rotation.T + start
        for strip in range(3):
            part = bumpy[12 * strip : 12 * strip + 13]
            patches.append((part, place_island(grid_uvs(part.shape[:2]), len(patches), 3 * len(limbs), generator), index))
    joined = _join(patches)
    item = add_object("body", replace(joined, materials=np.zeros_like(joined.materials)), generator)
    _add_armature(item, joined, generator)
    return item


def _add_armature(item: bpy.types.Object, mesh: TexturedMesh, generator: np.random.Generator) -> None:
    """Pose `item` by a bone for each of the materials of `mesh`, which moves its vertices."""
    armature = bpy.data.objects.new("Armature", bpy.data.armatures.new("Armature"))
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for limb in range(int(mesh.materials.max()) + 1):
        vertices = np.unique(mesh.triangles[mesh.materials == limb])
        center = mesh.vertices[vertices].mean(axis=0)
        bone = armature.data.edit_bones.new(f"limb {limb}")
        bone.head, bone.tail = center.tolist(), (center + [0.0, 0.0, 0.1]).tolist()
        item.vertex_groups.new(name=bone.name).add(vertices.tolist(), 1.0, "REPLACE")
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in armature.pose.bones:
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = generator.uniform(-0.25, 0.25, 3).tolist()
    item.modifiers.new("Armature", "ARMATURE").object = armature


def lathe(
    generator: np.random.Generator, cells: tuple[int, int], ends: tuple[float, float], radius: float, angles: tuple[float, float]
) -> np.ndarray:
    """Return a surface of revolution around z with a random profile and closed ends, (cells[0] + 1, cells[1] + 1, 3)."""
    angle = np.linspace(*angles, cells[0] + 1)[:, None]
    along = np.linspace(0.0, 1.0, cells[1] + 1)
    waves = generator.uniform(-0.12, 0.12, 4)
    profile = radius * (1.0 + sum(wave * np.sin((order + 1) * np.pi * along) for order, wave in enumerate(waves)))
    profile[[0, -1]] = 0.0
    height = ends[0] + (ends[1] - ends[0]) * along
    height[[0, -1]] = height[[1, -2]] if generator.uniform() < 0.5 else height[[0, -1]]  # flat or pointed ends
    return np.stack([profile * np.cos(angle), profile * np.sin(angle), height + 0.0 * angle], axis=2)


def _mirror(points: np.ndarray, uvs: np.ndarray, axis: int) -> list[Patch]:
    """Return a grid and its mirror image along an axis, with the same texture coordinates."""
    scale = np.where(np.arange(3) == axis, -1.0, 1.0)
    return [(points, uvs, 0), (points[::-1] * scale, uvs[::-1], 0)]


def _box(center: np.ndarray, half: np.ndarray, size: np.ndarray) -> list[np.ndarray]:
    """Return the six faces (R, C, 3) of a box. size: (3,) cells along its sides."""
    faces = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        u, v = np.meshgrid(np.linspace(-1.0, 1.0, size[first] + 1), np.linspace(-1.0, 1.0, size[second] + 1), indexing="ij")
        for side in (-1.0, 1.0):
            face = np.empty((*u.shape, 3))
            face[..., axis], face[..., first], face[..., second] = side, u, v
            face = center + half * face
            faces.append(face if side > 0.0 else face[::-1])
    return faces


def _random_rotation(generator: np.random.Generator) -> np.ndarray:
    """Return a rotation (3, 3) that leans an axis by up to a quarter turn."""
    return np.array(mathutils.Euler([*generator.uniform(-0.8, 0.8, 2), generator.uniform(0.0, 6.0)]).to_matrix())


def _join(patches: list[Patch]) -> TexturedMesh:
    points, uvs, materials = zip(*patches, strict=True)
    return join_patches([np.round(grid, 9) for grid in points], list(uvs), np.array(materials, np.int32))


def add_object(name: str, mesh: TexturedMesh, generator: np.random.Generator) -> bpy.types.Object:
    """Add a mesh to the scene, smooth but for hard edges, with a painted material for each of its material indices."""
    data = bpy.data.meshes.new(name)
    write_triangles(data, mesh.vertices, mesh.triangles)
    write_uvs(data.uv_layers.new(name="UVMap"), mesh.corner_uvs)
    data.polygons.foreach_set("material_index", mesh.materials)
    for number in range(int(mesh.materials.max()) + 1):
        data.materials.append(_paint_material(f"{name} {number}", generator))
    data.shade_smooth()
    data.set_sharp_from_angle(angle=SHARP_ANGLE)
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    return item


def _paint_material(name: str, generator: np.random.Generator) -> bpy.types.Material:
    material, nodes, links, surface = create_material(name)
    colors = encode_signed_srgb(paint(IMAGE_SIDE, generator))
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = create_image(name, np.concatenate([colors, np.ones((*colors.shape[:2], 1))], axis=2), is_data=False)
    links.new(texture.outputs["Color"], surface.inputs["Base Color"])
    surface.inputs["Roughness"].default_value = generator.uniform(0.2, 0.8)
    return material


GENERATORS: dict[str, Callable[[np.random.Generator], bpy.types.Object]] = {
    "streetlight": build_streetlight,
    "crate": build_crate,
    "terrace": build_terrace,
    "body": build_body,
}
