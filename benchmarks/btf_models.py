"""Models of the benchmarks of relightable textures, from files in ../shared/data, generated, and the tree of the demo."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import bpy

from farfield.addon.compat import enable_nodes
from farfield.addon.core.errors import FileError
from lib import environment, scene_files
from lib.demo_tree import grow_tree
from lib.shader_nodes import find_node

DATA = environment.ROOT.parent / "shared" / "data"
COAT = {"Base Color": (0.35, 0.42, 0.5, 1.0), "Roughness": 0.6, "Coat Weight": 0.8, "Coat Roughness": 0.2}
PAINT = {"Base Color": (0.45, 0.04, 0.03, 1.0), "Roughness": 0.35, "Coat Weight": 1.0, "Coat Roughness": 0.12}


@dataclass(frozen=True)
class Model:
    """make: creates the model in an empty scene from files in a folder. upper: whether it stands on the ground, so that only views and
    lights above the horizon matter."""

    make: Callable[[Path], None]
    upper: bool


def save_model(model: Model, path: Path, data: Path) -> None:
    """Write a file that contains only the model, created from files in the folder `data`.

    Raises:
        FileError: if an input file is missing or the output cannot be written.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    model.make(data)
    scene_files.save_scene(path)


def _open(path: Path, data: Path) -> None:
    scene_files.open_scene(_require(data / path))


def _open_painted(path: Path, parameters: dict[str, object], data: Path) -> None:
    """Open a model and give it a smooth surface of a Principled material with these `parameters`."""
    _open(path, data)
    _paint(parameters)


def _open_patterned(path: Path, data: Path) -> None:
    """Open a model and give it a procedural texture."""
    _open(path, data)
    material = _paint({"Roughness": 0.7})
    nodes, links = material.node_tree.nodes, material.node_tree.links
    noise, ramp, coordinates = (nodes.new(f"ShaderNode{name}") for name in ("TexNoise", "ValToRGB", "TexCoord"))
    noise.inputs["Scale"].default_value = 12.0
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (0.12, 0.08, 0.05, 1.0), (0.75, 0.68, 0.55, 1.0)
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.4, 0.6
    links.new(coordinates.outputs["Generated"], noise.inputs["Vector"])
    links.new(noise.outputs["Fac"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], find_node(material.node_tree, "BSDF_PRINCIPLED").inputs["Base Color"])


def _paint(parameters: dict[str, object]) -> bpy.types.Material:
    paint = bpy.data.materials.new("Paint")
    enable_nodes(paint)
    shader = find_node(paint.node_tree, "BSDF_PRINCIPLED")
    for name, value in parameters.items():
        shader.inputs[name].default_value = value
    for item in bpy.context.scene.objects:
        item.data.materials.clear()
        item.data.materials.append(paint)
        item.data.shade_smooth()
    return paint


def _figure(_data: Path) -> None:
    """A smooth figure with a head, large ears, arms and legs: parts that shade each other."""
    metaball = bpy.data.metaballs.new("Figure")
    metaball.resolution = 0.045
    metaball.threshold = 0.3
    figure = bpy.data.objects.new("Figure", metaball)
    bpy.context.scene.collection.objects.link(figure)
    parts = [((0.0, 0.0, 0.9), 0.55), ((0.0, 0.0, 1.35), 0.5), ((0.0, -0.02, 2.05), 0.55), ((0.0, -0.3, 2.0), 0.25)]
    for side in (-1.0, 1.0):
        parts += [((side * (0.35 + 0.09 * step), 0.0, 2.4 + 0.1 * step), 0.22) for step in range(5)]
        parts += [((side * (0.42 + 0.12 * step), -0.06 * step, 1.5 - 0.12 * step), 0.22) for step in range(6)]
        parts += [((side * 0.26, 0.0, 0.7 - 0.15 * step), 0.27) for step in range(5)]
    for position, radius in parts:
        element = metaball.elements.new()
        element.co, element.radius = position, radius
    _convert_to_mesh(figure)
    _paint({"Base Color": (0.72, 0.5, 0.38, 1.0), "Roughness": 0.5})


def _colonnade(_data: Path) -> None:
    """Two rows of columns on a base under a slab: long shadows on flat and round surfaces."""
    for x in range(6):
        for y in range(2):
            bpy.ops.mesh.primitive_cylinder_add(vertices=32, radius=0.16, depth=1.6, location=(0.7 * x, 0.9 * y, 0.95))
    for height, thickness in ((0.1, 0.2), (1.85, 0.2)):
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=(1.75, 0.45, height), scale=(4.1, 1.5, thickness))
    for item in bpy.context.scene.objects:
        item.select_set(True)
    bpy.context.view_layer.objects.active = bpy.context.scene.objects[0]
    bpy.ops.object.join()
    bpy.context.object.name = "Colonnade"
    bpy.context.object.data.shade_smooth_by_angle(angle=math.radians(40.0)) if hasattr(
        bpy.context.object.data, "shade_smooth_by_angle"
    ) else None
    material = bpy.data.materials.new("Stone")
    enable_nodes(material)
    find_node(material.node_tree, "BSDF_PRINCIPLED").inputs["Base Color"].default_value = (0.7, 0.66, 0.6, 1.0)
    bpy.context.object.data.materials.append(material)


def _convert_to_mesh(item: bpy.types.Object) -> None:
    bpy.context.view_layer.update()
    mesh = bpy.data.meshes.new_from_object(item.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(item.name, mesh))
    bpy.data.objects.remove(item)


def _demo_tree(_data: Path) -> None:
    grow_tree()


def _require(path: Path) -> Path:
    if not path.exists():
        raise FileError(f'The model "{path}" does not exist; set its folder with --data, or choose other models with --models.')
    return path


MODELS = {
    "max_planck": Model(partial(_open_painted, Path("meshes") / "max_planck.obj", PAINT), upper=False),
    "leafy_tree": Model(partial(_open, Path("trees") / "leafy_tree.glb"), upper=True),
    "demo_tree": Model(_demo_tree, upper=True),
    "spot": Model(partial(_open, Path("textured") / "spot" / "spot.obj"), upper=False),
    "blub": Model(partial(_open, Path("textured") / "blub" / "blub.glb"), upper=False),
    "bunny": Model(partial(_open_painted, Path("meshes") / "stanford_bunny.obj", COAT), upper=False),
    "pine_tree": Model(partial(_open, Path("trees") / "pine_tree.glb"), upper=False),
    "tree": Model(partial(_open, Path("trees") / "tree.glb"), upper=False),
    "sceaux": Model(partial(_open_patterned, Path("sceaux") / "mesh_15k.ply"), upper=False),
    "figure": Model(_figure, upper=False),
    "colonnade": Model(_colonnade, upper=False),
}
