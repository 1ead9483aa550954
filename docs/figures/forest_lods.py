"""A forest of a scene's tree: the source nearby, and at larger distances the level of its cloud whose error is below one pixel.

All trees are randomly rotated, lit by one low Sun light, and cast shadows.
"""

from collections import Counter
from pathlib import Path

import bpy
import mathutils
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.billboards.scene_clouds import SceneCloud
from farfield.addon.bridge.cameras import read_scene_camera
from farfield.addon.core.geometry.cameras import choose_level
from lib.atomic_output import atomic_file
from lib.demo_materials import create_material
from lib.shader_nodes import find_node
from lib.studio import MAX_TRANSPARENT_BOUNCES, look_at_matrix

SPACING = 6.8  # approximate distance between trees, meters
ROW_COUNT = 34
SCALE_RANGE = (0.8, 1.15)
OVERSCAN = 0.55  # width of the forest beyond the edge of the image, relative to half the width of the view
SUN_DIRECTION = np.array([-0.66, 0.30, 0.55])
GLADE_WIDTH, GLADE_DEPTH, GLADE_CURVATURE = 6.0, 70.0, 0.12
CAMERA_POSITION = np.array([0.0, -27.0, 13.0])
CAMERA_TARGET = np.array([0.0, 40.0, 1.5])


def render_forest(cloud: SceneCloud, path: Path, width: int, samples: int) -> Counter:
    """Plant a forest of `cloud` in its scene and render it to the PNG `path`, `width` pixels wide and half as high.

    Returns the number of trees per level; the key None is the source.
    """
    set_up_scene(width, samples)
    counts = plant(cloud)
    with atomic_file(path) as temporary:
        bpy.context.scene.render.filepath = str(temporary)
        bpy.ops.render.render(write_still=True)
    return counts


def plant(cloud: SceneCloud) -> Counter:
    """Place rotated trees in jittered rows in front of the camera; return their number per level, None for the source."""
    scene = bpy.context.scene
    camera = read_scene_camera(scene)
    random = np.random.default_rng(4)
    counts: Counter = Counter()
    for position in tree_positions(random):
        distance = float(np.linalg.norm(position - CAMERA_POSITION))
        level = choose_level(cloud.errors, distance - SPACING / 2.0, camera)
        rotation_scale = mathutils.Matrix.Rotation(random.uniform(0.0, 2.0 * np.pi), 4, "Z") @ mathutils.Matrix.Scale(
            random.uniform(*SCALE_RANGE), 4
        )
        for item in cloud.sources if level is None else [cloud.levels[level]]:
            copy = item.copy()  # shares the mesh and the material of `item`
            copy.matrix_world = mathutils.Matrix.Translation(position.tolist()) @ rotation_scale @ item.matrix_world
            copy.hide_render = copy.hide_viewport = False
            scene.collection.objects.link(copy)
        counts[level] += 1
    for item in [*cloud.sources, *cloud.levels]:
        item.hide_render = True
    return counts


def tree_positions(random: np.random.Generator) -> list[np.ndarray]:
    """Return the positions of the trees: rows that widen with the view, with a glade in front."""
    positions = []
    for row in range(ROW_COUNT):
        depth = row * SPACING * (1.0 + 0.06 * row)
        half_width = (1.0 + OVERSCAN) * 0.5 * (depth - CAMERA_POSITION[1])
        for x in np.arange(-half_width, half_width, SPACING * (1.0 + 0.03 * row)):
            position = np.array([x, depth, 0.0])
            position[:2] += random.uniform(-0.36, 0.36, 2) * SPACING
            if abs(position[0] - GLADE_CURVATURE * position[1]) > GLADE_WIDTH or depth > GLADE_DEPTH:
                positions.append(position)
    return positions


def set_up_scene(width: int, samples: int) -> None:
    """Set up camera, Sun light, World, meadow and Cycles."""
    scene = bpy.context.scene
    scene.camera.data.sensor_fit, scene.camera.data.angle = "HORIZONTAL", np.radians(46.0)
    scene.camera.data.clip_end = 5000.0
    scene.camera.matrix_world = look_at_matrix(
        (CAMERA_POSITION - CAMERA_TARGET) / np.linalg.norm(CAMERA_POSITION - CAMERA_TARGET), CAMERA_POSITION
    )
    sun = next(item for item in scene.objects if item.type == "LIGHT")
    sun.matrix_world = look_at_matrix(SUN_DIRECTION / np.linalg.norm(SUN_DIRECTION), np.zeros(3))
    sun.data.energy, sun.data.color = 5.0, (1.0, 0.86, 0.68)
    background = find_node(scene.world.node_tree, "BACKGROUND")
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (0.46, 0.62, 0.85, 1.0), 0.8
    _add_meadow(scene)
    render = scene.render
    render.engine, render.film_transparent, render.use_persistent_data = "CYCLES", False, False
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, width // 2, 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    render.image_settings.compression = 100
    scene.cycles.samples, scene.cycles.use_denoising = samples, True
    scene.cycles.transparent_max_bounces = MAX_TRANSPARENT_BOUNCES
    scene.cycles.max_bounces = 3
    scene.view_settings.view_transform = "Standard"
    bpy.context.view_layer.update()


def _add_meadow(scene: bpy.types.Scene) -> None:
    mesh = bpy.data.meshes.new("Meadow")
    mesh.from_pydata([(-4000, -200, 0), (4000, -200, 0), (4000, 6000, 0), (-4000, 6000, 0)], [], [(0, 1, 2, 3)])
    material, _, _, surface = create_material("Meadow")
    surface.inputs["Base Color"].default_value = (0.17, 0.22, 0.06, 1.0)
    surface.inputs["Roughness"].default_value = 1.0
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("Meadow", mesh))
