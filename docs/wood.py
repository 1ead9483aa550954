"""A wood of a scene's tree: near by the tree itself, farther off the level of its cloud whose error is less than a pixel there.

All trees are turned, lit by one low sun, and cast their shadows.
"""

from collections import Counter
from pathlib import Path

import bpy
import mathutils
import numpy as np

import environment

environment.import_farfield()

from demo_materials import new_material
from farfield.addon.bridge.cameras import scene_camera
from farfield.addon.core.cameras import choose_level
from farfield.addon.operators.billboards_clouds import StandingCloud
from studio import STACKED_QUADS, looking_along
from whole_files import whole_file

SPACING = 6.8  # metres between two trees, about
ROWS = 34
SIZES = (0.8, 1.15)  # of the scene's tree
OPENING = 0.55  # of the camera's half width that the wood fills beyond the picture's edge
SUN_DIRECTION = np.array([-0.66, 0.30, 0.55])
GLADE_WIDTH, GLADE_DEPTH, GLADE_BEND = 6.0, 70.0, 0.12
EYE = np.array([0.0, -27.0, 13.0])
GAZE = np.array([0.0, 40.0, 1.5])


def render_wood(cloud: StandingCloud, path: Path, width: int, samples: int) -> Counter:
    """Plant a wood of `cloud` in its scene and render it to the PNG `path`, half as high as `width` pixels.

    Returns how many trees stand there of each level; None counts the original.
    """
    set_up_picture(width, samples)
    planted = plant(cloud)
    with whole_file(path) as temporary:
        bpy.context.scene.render.filepath = str(temporary)
        bpy.ops.render.render(write_still=True)
    return planted


def plant(cloud: StandingCloud) -> Counter:
    """Stand turned trees in jittered rows before the camera; returns how many of each level, None for the original."""
    scene = bpy.context.scene
    camera = scene_camera(scene)
    random = np.random.default_rng(4)
    planted: Counter = Counter()
    for place in places(random):
        distance = float(np.linalg.norm(place - EYE))
        level = choose_level(cloud.errors, distance - SPACING / 2.0, camera)
        turn = mathutils.Matrix.Rotation(random.uniform(0.0, 2.0 * np.pi), 4, "Z") @ mathutils.Matrix.Scale(random.uniform(*SIZES), 4)
        for item in cloud.sources if level is None else [cloud.levels[level]]:
            copy = item.copy()  # shares the mesh and the material of `item`
            copy.matrix_world = mathutils.Matrix.Translation(place.tolist()) @ turn @ item.matrix_world
            copy.hide_render = copy.hide_viewport = False
            scene.collection.objects.link(copy)
        planted[level] += 1
    for item in [*cloud.sources, *cloud.levels]:
        item.hide_render = True
    return planted


def places(random: np.random.Generator) -> list[np.ndarray]:
    """Where trees stand: rows that widen with the view, with a glade in front."""
    found = []
    for row in range(ROWS):
        depth = row * SPACING * (1.0 + 0.06 * row)
        half_width = (1.0 + OPENING) * 0.5 * (depth - EYE[1])
        for across in np.arange(-half_width, half_width, SPACING * (1.0 + 0.03 * row)):
            place = np.array([across, depth, 0.0])
            place[:2] += random.uniform(-0.36, 0.36, 2) * SPACING
            if abs(place[0] - GLADE_BEND * place[1]) > GLADE_WIDTH or depth > GLADE_DEPTH:
                found.append(place)
    return found


def set_up_picture(width: int, samples: int) -> None:
    """Camera, sun, sky, meadow and Cycles for the picture."""
    scene = bpy.context.scene
    scene.camera.data.sensor_fit, scene.camera.data.angle = "HORIZONTAL", np.radians(46.0)
    scene.camera.data.clip_end = 5000.0
    scene.camera.matrix_world = looking_along((EYE - GAZE) / np.linalg.norm(EYE - GAZE), EYE)
    sun = next(item for item in scene.objects if item.type == "LIGHT")
    sun.matrix_world = looking_along(SUN_DIRECTION / np.linalg.norm(SUN_DIRECTION), np.zeros(3))
    sun.data.energy, sun.data.color = 5.0, (1.0, 0.86, 0.68)
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (0.46, 0.62, 0.85, 1.0), 0.8
    _add_meadow(scene)
    render = scene.render
    render.engine, render.film_transparent, render.use_persistent_data = "CYCLES", False, False
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, width // 2, 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    render.image_settings.compression = 100
    scene.cycles.samples, scene.cycles.use_denoising = samples, True
    scene.cycles.transparent_max_bounces = STACKED_QUADS
    scene.cycles.max_bounces = 3
    scene.view_settings.view_transform = "Standard"
    bpy.context.view_layer.update()


def _add_meadow(scene: bpy.types.Scene) -> None:
    mesh = bpy.data.meshes.new("Meadow")
    mesh.from_pydata([(-4000, -200, 0), (4000, -200, 0), (4000, 6000, 0), (-4000, 6000, 0)], [], [(0, 1, 2, 3)])
    material, _, _, surface = new_material("Meadow")
    surface.inputs["Base Color"].default_value = (0.17, 0.22, 0.06, 1.0)
    surface.inputs["Roughness"].default_value = 1.0
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("Meadow", mesh))
