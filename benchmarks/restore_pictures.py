"""Pictures with objects for `bench_restore.py`: photographs, and scenes that Cycles renders, other ones for each random generator.

Images are (H, W, 3) float32 sRGB values in 0..1, row 0 at the bottom.
"""

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from restore_textures import Crop
from restore_textures import crop as cut_out

SIZE = (300, 400)  # rows and columns
SAMPLES = 24
Generator = np.random.Generator

JUDGING_PHOTOGRAPHS = {
    "astronaut": Crop("astronaut.png", (20, 20), (400, 400)),
    "astronaut background": Crop("astronaut.png", (130, 20), (360, 400)),
    "cat": Crop("chelsea.png", (0, 20), (300, 400)),
    "hats": Crop("kodim03.png", (40, 20), (400, 500)),
    "hats wall": Crop("kodim03.png", (80, 250), (400, 480)),
    "wikkie": Crop("wikkie.png", (40, 40), (420, 420)),
    "camera": Crop("skimage:camera.png", (40, 60), (420, 420)),
    "clock": Crop("skimage:clock_motion.png", (0, 0), (284, 384)),
}
TUNING_PHOTOGRAPHS = {
    "coffee": Crop("skimage:coffee.png", (0, 60), (380, 480)),
    "cell": Crop("skimage:cell.png", (100, 60), (420, 420)),
    "rocket": Crop("skimage:rocket.jpg", (20, 100), (380, 480)),
    "motorcycle": Crop("skimage:motorcycle_left.png", (60, 100), (400, 500)),
}
ALL_PHOTOGRAPHS = JUDGING_PHOTOGRAPHS | TUNING_PHOTOGRAPHS


def read_photograph(crop: Crop, random: Generator, read: Callable[[str], np.ndarray], data: Path) -> np.ndarray:
    """Read a photograph with `read` and cut out the crop, moved at random."""
    pixels = read(crop.file if crop.file.startswith("skimage:") else str(data.absolute() / crop.file))
    return cut_out(np.broadcast_to(pixels, (*pixels.shape[:2], 3)), crop, random)


def plates(random: Generator) -> None:
    """Build plates and a cup on a wooden table."""
    _add_plane(_material(random, "wood"), 6.0)
    for _ in range(3):
        x, y = random.uniform(-0.9, 0.9, 2)
        radius, color = random.uniform(0.35, 0.7), random.uniform(0.2, 0.9, 3)
        _add_lathe([(0.0, 0.03), (0.6 * radius, 0.03), (0.7 * radius, 0.05), (radius, 0.12), (radius, 0.1)], (x, y, 0.0), _paint(color))
        if random.random() < 0.6:
            height = random.uniform(0.25, 0.4)
            cup = [(0.0, 0.05), (0.16, 0.05), (0.2, height), (0.17, height), (0.14, 0.8 * height), (0.0, 0.8 * height)]
            _add_lathe(cup, (x, y, 0.0), _paint(random.uniform(0.2, 0.9, 3)))
    _add_camera((0.0, -2.6, random.uniform(1.6, 3.0)), (0.0, 0.0, 0.0), 40.0)


def room(random: Generator) -> None:
    """Build a corner of a room with a tiled floor, a picture, a shelf and boxes."""
    _add_plane(_material(random, "tiles"), 6.0)
    wall = _paint(random.uniform(0.4, 0.9, 3))
    _add_box((0.0, 2.0, 1.5), (6.0, 0.1, 3.0), 0.0, wall)
    _add_box((-2.0, 0.0, 1.5), (0.1, 6.0, 3.0), 0.0, wall)
    frame, where = _paint(random.uniform(0.02, 0.3, 3)), random.uniform(-0.8, 0.8)
    _add_box((where, 1.93, 1.6), (0.9, 0.06, 0.7), 0.0, frame)
    _add_box((where, 1.89, 1.6), (0.75, 0.06, 0.55), 0.0, _material(random, "marble"))
    for _ in range(4):
        x, y, size = random.uniform(-1.4, 1.4), random.uniform(0.0, 1.6), random.uniform(0.25, 0.6, 3)
        _add_box((x, y, 0.5 * size[2]), tuple(size), random.uniform(0.0, math.pi), _paint(random.uniform(0.05, 0.9, 3)))
    _add_camera((random.uniform(0.4, 1.4), -2.8, random.uniform(1.2, 1.8)), (-0.2, 1.0, 0.9), 30.0)


def windows(random: Generator) -> None:
    """Build a facade of bricks with windows that reflect the sky."""
    _add_box((0.0, 0.0, 0.0), (8.0, 0.2, 8.0), 0.0, _material(random, "bricks"))
    glass, frame = _paint((0.03, 0.04, 0.06), roughness=0.05), _paint(random.uniform(0.3, 0.9, 3))
    step, width, height = random.uniform(1.0, 1.3), random.uniform(0.45, 0.6), random.uniform(0.6, 0.9)
    for column in range(-2, 3):
        for row in range(-2, 3):
            center = (column * step, -0.1, row * 1.3)
            _add_box(center, (width + 0.12, 0.1, height + 0.12), 0.0, frame)
            _add_box((center[0], -0.14, center[2]), (width, 0.06, height), 0.0, glass)
            _add_box((center[0], -0.18, center[2]), (0.04, 0.03, height), 0.0, frame)
    _add_camera((random.uniform(-2.0, 2.0), -4.0, random.uniform(-1.0, 0.5)), (0.0, 0.0, 0.2), 38.0)


def text(random: Generator) -> None:
    """Build printed lines on paper, seen at a slant."""
    _add_plane(_paint((0.85, 0.83, 0.78)), 8.0)
    words = ["plate", "window", "horizon", "garden", "stone", "river", "cloud", "bridge", "mountain", "light"]
    for line in range(7):
        bpy.ops.object.text_add(location=(-1.8, 0.9 - 0.32 * line, 0.002))
        bpy.context.object.data.body = " ".join(random.choice(words, 4))
        bpy.context.object.data.size = 0.3
        bpy.context.object.data.materials.append(_paint((0.02, 0.02, 0.03)))
    _add_box((1.5, -0.9, 0.05), (0.12, 1.6, 0.1), random.uniform(-0.6, 0.6), _paint(random.uniform(0.05, 0.9, 3)))
    _add_camera((random.uniform(-0.6, 0.6), -2.2, 2.6), (-0.1, -0.1, 0.0), 40.0)


def horizon(random: Generator) -> None:
    """Build the sea below a plain sky, a boat and a lighthouse."""
    _add_plane(_material(random, "water"), 400.0)
    x, color = random.uniform(-3.0, 3.0), random.uniform(0.1, 0.9, 3)
    _add_lathe([(0.9, 0.0), (0.5, 5.0), (0.7, 5.1), (0.7, 5.3), (0.4, 5.4), (0.4, 6.2), (0.0, 6.8)], (x, 18.0, 0.0), _paint(color))
    for _ in range(2):
        boat = (random.uniform(-3.0, 3.0), random.uniform(6.0, 12.0), 0.2)
        _add_box(boat, (1.4, 0.5, 0.4), random.uniform(0.0, math.pi), _paint(random.uniform(0.05, 0.9, 3)))
        _add_box((*boat[:2], 1.2), (0.05, 0.05, 2.0), 0.0, _paint((0.8, 0.8, 0.8)))
    _add_camera((0.0, -4.0, random.uniform(1.2, 2.5)), (0.0, 12.0, random.uniform(1.0, 3.0)), 35.0)


SCENES = {"plates": plates, "room": room, "windows": windows, "text": text, "horizon": horizon}
PICTURES = {  # The number is that of a scene of the kind.
    "judging": [*JUDGING_PHOTOGRAPHS, *(f"{kind} {number}" for number in (1, 2, 3) for kind in SCENES)],
    "tuning": [*TUNING_PHOTOGRAPHS, *(f"{kind} 1" for kind in SCENES)],
}


def render(name: str, random: Generator) -> np.ndarray:
    """Render a scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    SCENES[name](random)
    scene = bpy.context.scene
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle = random.uniform(1.5, 3.0), random.uniform(0.01, 0.2)
    sun.rotation_euler = random.uniform(0.3, 0.9), random.uniform(-0.5, 0.5), random.uniform(-1.5, 1.5)
    scene.collection.objects.link(sun)
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*random.uniform((0.3, 0.45, 0.6), (0.5, 0.6, 0.9)), 1.0)
    scene.render.engine, scene.cycles.samples, scene.cycles.seed = "CYCLES", SAMPLES, int(random.integers(2**31))
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_y, scene.render.resolution_x = SIZE
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        scene.render.filepath = str(Path(folder) / "picture.png")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = np.empty(4 * SIZE[0] * SIZE[1], np.float32)
        image.pixels.foreach_get(pixels)
    return pixels.reshape(*SIZE, 4)[..., :3].copy()


def _paint(color: Any, roughness: float = 0.4) -> Any:
    material = bpy.data.materials.new("Paint")
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return material


def _material(random: Generator, kind: str) -> Any:
    """Return a material with a procedural texture of two random colors."""
    material = _paint(random.uniform(0.2, 0.8, 3), 0.15 if kind == "water" else 0.6)
    tree = material.node_tree
    shader = tree.nodes["Principled BSDF"]
    coordinates, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    tree.links.new(coordinates.outputs["Object"], mapping.inputs["Vector"])
    texture = tree.nodes.new(
        {"bricks": "ShaderNodeTexBrick", "tiles": "ShaderNodeTexChecker", "water": "ShaderNodeTexNoise"}.get(kind, "ShaderNodeTexWave")
    )
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    if kind == "water":
        texture.inputs["Scale"].default_value = 1.5
        bump = tree.nodes.new("ShaderNodeBump")
        bump.inputs["Strength"].default_value = 0.4
        tree.links.new(texture.outputs[0], bump.inputs["Height"])
        tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
        shader.inputs["Base Color"].default_value = (0.02, 0.06, 0.09, 1.0)
        return material
    if kind == "bricks":
        mapping.inputs["Rotation"].default_value = (0.5 * math.pi, 0.0, 0.0)
    texture.inputs["Scale"].default_value = {"bricks": 5.0, "tiles": 4.0}.get(kind, 2.0)
    first = random.uniform(0.15, 0.7, 3)
    if kind in ("bricks", "tiles"):
        texture.inputs["Color1"].default_value = (*first, 1.0)
        texture.inputs["Color2"].default_value = (*(first * random.uniform(0.4, 0.7)), 1.0)
        tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        return material
    texture.inputs["Distortion"].default_value, texture.inputs["Detail"].default_value = (8.0, 5.0) if kind == "marble" else (3.0, 4.0)
    mix = tree.nodes.new("ShaderNodeMixRGB")
    mix.inputs["Color1"].default_value = (*first, 1.0)
    mix.inputs["Color2"].default_value = (*(first * random.uniform(0.4, 0.7)), 1.0)
    tree.links.new(texture.outputs["Fac"] if "Fac" in texture.outputs else texture.outputs[1], mix.inputs["Fac"])
    tree.links.new(mix.outputs["Color"], shader.inputs["Base Color"])
    return material


def _add_plane(material: Any, size: float) -> None:
    bpy.ops.mesh.primitive_plane_add(size=size)
    bpy.context.object.data.materials.append(material)


def _add_box(center: Any, size: Any, rotation: float, material: Any) -> None:
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=center, rotation=(0.0, 0.0, rotation))
    bpy.context.object.scale = size
    bpy.context.object.data.materials.append(material)


def _add_lathe(profile: list[tuple[float, float]], location: Any, material: Any) -> None:
    """Add the surface that the `profile` of radii and heights forms around a vertical axis."""
    count = 96
    angles = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    vertices = [(radius * math.cos(angle), radius * math.sin(angle), height) for radius, height in profile for angle in angles]
    faces = [
        (row * count + i, row * count + (i + 1) % count, (row + 1) * count + (i + 1) % count, (row + 1) * count + i)
        for row in range(len(profile) - 1)
        for i in range(count)
    ]
    mesh = bpy.data.meshes.new("Lathe")
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(material)
    found = bpy.data.objects.new("Lathe", mesh)
    found.location = location
    bpy.context.scene.collection.objects.link(found)


def _add_camera(position: Any, target: Any, lens: float) -> None:
    from mathutils import Vector

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.lens = position, lens
    camera.rotation_euler = (Vector(target) - Vector(position)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
