"""Models that `bench_billboards.py --only ordinary` generates, other ones for each seed: much of what clouds find hard.

These are thin rods and ropes, columns in rows, a house of many objects with rooms behind glass and light in its windows, and leaves that
light shines through.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import bmesh
import bpy
import mathutils
import numpy as np

from farfield.addon.bridge.geometry.mesh_arrays import write_triangles
from lib.demo_materials import create_material
from lib.shader_nodes import find_node

SHARP_ANGLE = math.radians(35.0)  # between faces at hard edges
Point = Sequence[float]


class Builder:
    """Adds boxes, rods and cards to one mesh, with the material of the given index."""

    def __init__(self) -> None:
        self.mesh = bmesh.new()

    def box(self, center: Point, size: Point, material: int = 0, angle: float = 0.0) -> None:
        """Add a box that is turned around z."""
        frame = mathutils.Matrix.LocRotScale(mathutils.Vector(center), mathutils.Euler((0.0, 0.0, angle)), mathutils.Vector(size))
        self._mark(bmesh.ops.create_cube(self.mesh, size=1.0, matrix=frame)["verts"], material)

    def rod(self, start: Point, end: Point, radii: tuple[float, float], sides: int, material: int = 0) -> None:
        """Add a closed cone frustum from `start` to `end`, with a radius at each."""
        axis = mathutils.Vector(end) - mathutils.Vector(start)
        turned = mathutils.Vector((0.0, 0.0, 1.0)).rotation_difference(axis).to_matrix().to_4x4()
        frame = mathutils.Matrix.Translation((mathutils.Vector(start) + mathutils.Vector(end)) / 2.0) @ turned
        cone = bmesh.ops.create_cone(
            self.mesh, cap_ends=True, segments=sides, radius1=radii[0], radius2=radii[1], depth=axis.length, matrix=frame
        )
        self._mark(cone["verts"], material)

    def sheet(self, points: np.ndarray, material: int = 0) -> None:
        """Add a surface through a grid of points (R, C, 3)."""
        rows = [[self.mesh.verts.new(point) for point in row.tolist()] for row in points]
        for one, other in pairwise(rows):
            for index in range(len(one) - 1):
                self.mesh.faces.new((one[index], one[index + 1], other[index + 1], other[index])).material_index = material

    def _mark(self, vertices: Sequence[bmesh.types.BMVert], material: int) -> None:
        for face in {face for vertex in vertices for face in vertex.link_faces}:
            face.material_index = material

    def add_object(self, name: str, materials: Sequence[bpy.types.Material]) -> bpy.types.Object:
        """Add the mesh to the scene, smooth but for hard edges."""
        data = bpy.data.meshes.new(name)
        self.mesh.to_mesh(data)
        self.mesh.free()
        for material in materials:
            data.materials.append(material)
        data.shade_smooth()
        data.set_sharp_from_angle(angle=SHARP_ANGLE)
        item = bpy.data.objects.new(name, data)
        bpy.context.scene.collection.objects.link(item)
        return item


def _material(name: str, generator: np.random.Generator, color: Point, **parameters: float | Point) -> bpy.types.Material:
    """Return a Principled material of about this color, with inputs named like `parameters`, where underscores stand for spaces."""
    material, _, _, surface = create_material(name)
    varied = np.clip(np.array(color) * generator.uniform(0.8, 1.2, 3), 0.0, 1.0)
    surface.inputs["Base Color"].default_value = (*varied.tolist(), 1.0)
    for key, value in parameters.items():
        surface.inputs[key.replace("_", " ")].default_value = value
    return material


def _leaf_material(generator: np.random.Generator) -> bpy.types.Material:
    """Return a material that lets half of the light through."""
    material = _material("Leaf", generator, (0.12, 0.3, 0.05), Roughness=0.5)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    surface, output = (find_node(material.node_tree, kind) for kind in ("BSDF_PRINCIPLED", "OUTPUT_MATERIAL"))
    translucent, mixed = nodes.new("ShaderNodeBsdfTranslucent"), nodes.new("ShaderNodeMixShader")
    translucent.inputs["Color"].default_value = (0.3, 0.5, 0.08, 1.0)
    links.new(surface.outputs[0], mixed.inputs[1])
    links.new(translucent.outputs[0], mixed.inputs[2])
    links.new(mixed.outputs[0], output.inputs["Surface"])
    return material


def build_colonnade(generator: np.random.Generator) -> list[bpy.types.Object]:
    """Return a round or straight row of columns with bases and capitals under a beam."""
    builder, count, half_angle = Builder(), int(generator.integers(6, 12)), generator.uniform(0.0, 0.9)
    angles = np.linspace(-half_angle, half_angle, count)
    places = np.stack([np.linspace(-0.45, 0.45, count) * count * np.cos(angles), count * (1.0 - np.cos(angles))], axis=1)
    height, radius = generator.uniform(2.0, 3.2), generator.uniform(0.14, 0.22)
    for x, y in places:
        builder.box((x, y, 0.1), (3.0 * radius, 3.0 * radius, 0.2))
        builder.rod((x, y, 0.2), (x, y, height), (radius, 0.85 * radius), 24)
        builder.rod((x, y, height), (x, y, height + 0.2), (0.85 * radius, 1.5 * radius), 24)
    for index, (one, other) in enumerate(pairwise(places)):
        center, span = (one + other) / 2.0, other - one
        length = float(np.hypot(*span)) + radius
        builder.box((*center, height + 0.35 + 0.01 * (index % 2)), (length, 3.4 * radius, 0.3), angle=math.atan2(span[1], span[0]))
    return [builder.add_object("Colonnade", [_material("Stone", generator, (0.65, 0.6, 0.52), Roughness=0.8)])]


def build_ship(generator: np.random.Generator) -> list[bpy.types.Object]:
    """Return a ship with masts, yards, sails of one layer and shrouds with ratlines."""
    wood, canvas, rope = range(3)
    builder, length, beam = Builder(), generator.uniform(9.0, 13.0), generator.uniform(1.1, 1.6)
    along, around = np.meshgrid(np.linspace(-1.0, 1.0, 25), np.linspace(0.0, np.pi, 13), indexing="ij")
    width = beam * np.maximum(1.0 - np.abs(along) ** 3, 0.02)
    hull = np.stack([0.5 * length * along, width * np.cos(around), 1.0 - 1.3 * np.sin(around) * np.sqrt(width / beam)], axis=2)
    builder.sheet(hull, wood)
    builder.sheet(np.stack([hull[:, 0], hull[:, -1]], axis=1) - [0.0, 0.0, 0.15], wood)
    for x in np.linspace(-0.3, 0.3, 3) * length:
        height = generator.uniform(6.0, 8.0)
        builder.rod((x, 0.0, 0.0), (x, 0.0, height), (0.14, 0.07), 10, wood)
        for level in (0.45, 0.7, 0.92):
            half = 2.4 * beam * (1.2 - level)
            builder.rod((x, -half, level * height), (x, half, level * height), (0.05, 0.05), 6, wood)
            across, up = np.meshgrid(np.linspace(-0.95, 0.95, 9), np.linspace(0.02, 0.2, 7), indexing="ij")
            belly = 0.5 * (1.0 - across**2) * np.sin(np.pi * up / 0.22)
            builder.sheet(np.stack([x + 0.1 + belly, half * across, (level - up) * height], axis=2), canvas)
        for side in (-1.0, 1.0):
            feet = [(x + offset, side * beam * 0.95, 0.9) for offset in np.linspace(-0.6, 0.6, 5)]
            top = (x, 0.0, 0.7 * height)
            for foot in feet:
                builder.rod(foot, top, (0.02, 0.02), 4, rope)
            for step in np.linspace(0.08, 0.75, 9):
                ends = [(1.0 - step) * np.array(foot) + step * np.array(top) for foot in (feet[0], feet[-1])]
                builder.rod(*ends, (0.012, 0.012), 4, rope)
    return [
        builder.add_object(
            "Ship",
            [
                _material("Wood", generator, (0.3, 0.17, 0.08), Roughness=0.6),
                _material("Canvas", generator, (0.75, 0.7, 0.58), Roughness=0.9),
                _material("Rope", generator, (0.35, 0.27, 0.16), Roughness=0.9),
            ],
        )
    ]


def build_house(generator: np.random.Generator) -> list[bpy.types.Object]:
    """Return a house of some forty objects: walls with openings, rooms with furniture, glowing windows, a roof, a fence."""
    wall = _material("Plaster", generator, (0.7, 0.62, 0.5), Roughness=0.9)
    tile = _material("Tiles", generator, (0.4, 0.13, 0.08), Roughness=0.7)
    wood = _material("Boards", generator, (0.28, 0.18, 0.1), Roughness=0.6)
    light = {"Emission_Color": (1.0, 0.75, 0.4, 1.0), "Emission_Strength": 2.0}
    emissive = _material("Lit Window", generator, (0.05, 0.05, 0.05), Roughness=0.2, **light)
    items, width, depth = [], generator.uniform(6.0, 9.0), generator.uniform(4.5, 6.0)
    height = 5.0

    def part(name: str, material: bpy.types.Material, *boxes: tuple[Point, Point]) -> None:
        builder = Builder()
        for center, size in boxes:
            builder.box(center, size)
        items.append(builder.add_object(name, [material]))

    for side in (-1.0, 1.0):
        openings = np.linspace(-0.5, 0.5, 4)[1:-1] * width
        edges = np.concatenate([[-0.5 * width], np.stack([openings - 0.5, openings + 0.5], axis=1).ravel(), [0.5 * width]])
        y = side * 0.5 * depth
        piers = [((0.5 * (a + b), y, 0.5 * height), (b - a, 0.25, height)) for a, b in edges.reshape(-1, 2)]
        lintels = [((x, y, z), (1.0, 0.25, thickness)) for x in openings for z, thickness in ((0.5, 1.0), (2.75, 0.7), (4.8, 0.4))]
        part("Wall", wall, *piers, *lintels)
        part("Gable", wall, ((side * 0.5 * width, 0.0, 0.5 * height), (0.25, depth, height)))
        for x in openings:
            for z in (1.7, 3.85):
                if generator.uniform() < 0.4:
                    part("Pane", emissive, ((x, y, z), (1.0, 0.03, 1.5)))
                part("Frame", wood, ((x, y - side * 0.05, z), (0.06, 0.08, 1.5)), ((x, y - side * 0.05, z), (1.0, 0.08, 0.06)))
        roof = Builder()
        ridge, eave = np.array([0.0, 0.0, height + 0.45 * depth]), np.array([0.0, side * 0.6 * depth, height - 0.1])
        ends = np.array([-0.55 * width, 0.55 * width])
        across = np.linspace(0.0, 1.0, 13)[:, None, None]
        points = ridge + across * (eave - ridge) + np.stack([ends, 0.0 * ends, 0.0 * ends], axis=1)[None]
        roof.sheet(points if side > 0.0 else points[::-1])
        items.append(roof.add_object("Roof", [tile]))
    for z in (0.05, 2.6, 5.0):
        part("Floor", wood, ((0.0, 0.0, z), (width - 0.2, depth - 0.2, 0.1)))
    for _ in range(6):
        size = generator.uniform(0.4, 1.2, 3)
        x, y = generator.uniform(-0.4, 0.4, 2) * (width, depth)
        part("Furniture", wood, ((x, y, float(generator.choice([0.1, 2.65])) + 0.5 * size[2]), size))
    part("Chimney", wall, ((0.25 * width, 0.15 * depth, height + 0.4 * depth), (0.7, 0.7, 2.0)))
    posts = np.linspace(-0.8, 0.8, 17) * width
    part(
        "Fence",
        wood,
        *(((x, -0.95 * depth, 0.5), (0.08, 0.05, 1.0)) for x in posts),
        ((0.0, -0.95 * depth, 0.75), (1.6 * width, 0.04, 0.08)),
    )
    return items


def build_scaffold(generator: np.random.Generator) -> list[bpy.types.Object]:
    """Return a scaffold of thin tubes with diagonals and some boards."""
    builder, bays, floors = Builder(), int(generator.integers(3, 6)), int(generator.integers(3, 6))
    for x in range(bays + 1):
        for y in (0.0, 0.9):
            builder.rod((2.0 * x, y, 0.0), (2.0 * x, y, 2.0 * floors + 1.0), (0.03, 0.03), 8)
        for z in range(1, floors + 1):
            builder.rod((2.0 * x, 0.0, 2.0 * z), (2.0 * x, 0.9, 2.0 * z), (0.03, 0.03), 8)
    for z in range(1, floors + 1):
        for y in (0.0, 0.9):
            for rail in (0.0, 0.9):
                builder.rod((0.0, y, 2.0 * z + rail), (2.0 * bays, y, 2.0 * z + rail), (0.03, 0.03), 8)
        for x in range(bays):
            if generator.uniform() < 0.6:
                start, end = (2.0 * x, 2.0 * x + 2.0) if generator.uniform() < 0.5 else (2.0 * x + 2.0, 2.0 * x)
                builder.rod((start, 0.9, 2.0 * z - 2.0), (end, 0.9, 2.0 * z), (0.025, 0.025), 8)
            if generator.uniform() < 0.8:
                builder.box((2.0 * x + 1.0, 0.45, 2.0 * z + 0.05), (1.95, 0.7, 0.05), 1)
    steel = _material("Steel", generator, (0.5, 0.5, 0.52), Roughness=0.4, Metallic=1.0)
    return [builder.add_object("Scaffold", [steel, _material("Boards", generator, (0.5, 0.36, 0.2), Roughness=0.8)])]


def build_bush(generator: np.random.Generator) -> list[bpy.types.Object]:
    """Return a bush of translucent leaves, each two triangles that are folded along the center, around stems."""
    count = int(generator.integers(1500, 3000))
    directions = generator.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    centers = directions * generator.uniform(0.55, 1.0, (count, 1)) * (1.2, 1.0, 0.9) + (0.0, 0.0, 1.0)
    axes = directions + generator.normal(scale=0.7, size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    across = np.cross(axes, generator.normal(size=(count, 3)))
    across *= 0.35 / np.linalg.norm(across, axis=1)[:, None]
    fold = 0.12 * np.cross(axes, across)
    corners = np.stack([-0.5 * axes, across + fold, 0.5 * axes, fold - across], axis=1) * generator.uniform(0.1, 0.18, (count, 1, 1))
    triangles = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]
    mesh = bpy.data.meshes.new("Bush")
    write_triangles(mesh, (centers[:, None] + corners).reshape(-1, 3), triangles.reshape(-1, 3))
    mesh.materials.append(_leaf_material(generator))
    leaves = bpy.data.objects.new("Bush", mesh)
    bpy.context.scene.collection.objects.link(leaves)
    stems = Builder()
    for center in centers[:: max(count // 40, 1)]:
        stems.rod((0.0, 0.0, 0.0), center, (0.025, 0.008), 6)
    return [leaves, stems.add_object("Stems", [_material("Bark", generator, (0.2, 0.13, 0.08), Roughness=0.9)])]


GENERATORS: dict[str, Callable[[np.random.Generator], list[bpy.types.Object]]] = {
    "colonnade": build_colonnade,
    "ship": build_ship,
    "house": build_house,
    "scaffold": build_scaffold,
    "bush": build_bush,
}
