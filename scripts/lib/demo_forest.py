"""A forest of one relightable cloud in a separate file that renders without Farfield: four times of day in four keyframes.

The trees are instances of the cloud's collection. They are lit by the Sun light and the World, and shade each other and the ground. With
the model *emission* all instances share the drivers of the instanced object; each one converts the light directions to its local space.
"""

import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import mathutils
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.billboards.level_objects import pbr_material
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud
from farfield.addon.bridge.btf.levels.emission_levels import link_suns, needs_linked_suns
from farfield.addon.bridge.btf.materials.emission_material import AMBIENT
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.compat import enable_nodes, set_file_format
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.jobs.progress import Progress, Steps
from lib import scene_files
from lib.contact_sheet import draw_contact_sheet
from lib.shader_nodes import find_node
from lib.studio import SUN_ANGLE, look_at_matrix, set_uniform_sky

TREE_COUNT = 1000
SCALE_RANGE = (0.8, 1.2)
SPACING = 1.35  # between trees, in widths of the cloud
JITTER = 0.35  # fraction of the spacing
FIRST_ROW_DISTANCE = 8.0  # from the camera, in widths of the cloud
CAMERA_HEIGHT = 3.2  # in heights of the cloud
FIELD_OF_VIEW = np.radians(46.0)  # horizontal
CAMERA_TILT = 0.17  # tangent of the angle below the horizon
MAX_TRANSPARENT_BOUNCES = 1024  # the maximum of Cycles: many quads overlap in a view
FRAMES_PER_HOUR = 40
POLL_SECONDS = 0.2  # interval between checks of the render process


@dataclass(frozen=True)
class Hour:
    """A time of day. sun_direction: towards the Sun light; the camera looks along +Y. color, strength (W/m2): of the Sun light."""

    name: str
    sun_direction: tuple[float, float, float]
    color: tuple[float, float, float]
    strength: float
    sky_radiance: tuple[float, float, float]


DAY = (
    Hour("morning", (0.90, 0.25, 0.26), (1.0, 0.66, 0.38), 6.0, (0.30, 0.36, 0.48)),
    Hour("noon", (0.25, -0.45, 1.10), (1.0, 0.97, 0.92), 3.6, (0.40, 0.56, 0.82)),
    Hour("evening", (-0.92, -0.10, 0.19), (1.0, 0.45, 0.18), 6.0, (0.26, 0.20, 0.30)),
    Hour("overcast", (-0.92, -0.10, 0.19), (1.0, 0.45, 0.18), 0.0, (0.72, 0.78, 0.85)),
)


def write_forest(cloud: SceneCloud, path: Path, width: int, samples: int) -> None:
    """Write the `.blend` file `path`: a forest of `cloud`, which has one relightable level, on flat ground under one Sun light.

    Replaces the open scene. Renders of the file are `width` pixels wide, with `samples` Cycles samples per pixel.

    Raises:
        FileError: the file cannot be written.
    """
    collection = _isolate_collection(cloud)
    scene = bpy.context.scene
    (level,) = collection.objects
    scene.collection.children.link(collection)
    low, high = _world_bounds(level)
    base = np.array([*(0.5 * (low + high))[:2], low[2]])
    collection.instance_offset = base
    tree_width, height = float(max((high - low)[:2])), float(high[2] - low[2])
    camera_position = base + [0.0, -FIRST_ROW_DISTANCE * tree_width, CAMERA_HEIGHT * height]
    plant(collection, base, tree_width)
    _add_ground(scene, base, tree_width)
    sun = _add_sun(scene)
    link_suns(level, [sun], DAY[0].sky_radiance)
    _keyframe_day(scene, level, sun)
    _set_up_camera(scene, camera_position)
    _set_up_render(scene, width, samples)
    scene_files.save_scene(path)


def plant(collection: bpy.types.Collection, base: np.ndarray, width: float) -> list[bpy.types.Object]:
    """Create TREE_COUNT randomly rotated and scaled instances of `collection` in jittered rows behind `base` (3,)."""
    random = np.random.default_rng(0)
    trees = []
    for position in tree_positions(random):
        item = bpy.data.objects.new("Tree", None)
        item.instance_type, item.instance_collection = "COLLECTION", collection
        item.empty_display_size = 0.1 * width
        item.location = base + [*(width * position), 0.0]
        item.rotation_euler.z = random.uniform(0.0, 2.0 * np.pi)
        item.scale = [random.uniform(*SCALE_RANGE)] * 3
        bpy.context.scene.collection.objects.link(item)
        trees.append(item)
    return trees


def tree_positions(random: np.random.Generator) -> np.ndarray:
    """Return positions (TREE_COUNT, 2) in widths of a tree. The center of the first row, the origin, stays free for the cloud itself."""
    positions: list[tuple[float, float]] = []
    depth = 0.0
    while len(positions) < TREE_COUNT:
        half = int(np.ceil(1.15 * np.tan(0.5 * FIELD_OF_VIEW) * (FIRST_ROW_DISTANCE + depth) / SPACING))
        positions += [(SPACING * column, depth) for column in range(-half, half + 1) if column or depth]
        depth += SPACING
    return np.array(positions[:TREE_COUNT]) + JITTER * SPACING * random.uniform(-1.0, 1.0, (TREE_COUNT, 2))


def render_day(path: Path) -> Steps[np.ndarray]:
    """Render the times of day of the forest in `path` in a process without Farfield; return a contact sheet (H, W, 3) of them.

    Raises:
        FileError: the process does not render them.
    """
    with temporary_folder() as folder:
        images = [folder / f"{frame_of_hour(index)}.png" for index in range(len(DAY))]
        process = subprocess.Popen(
            _render_command([str(path), str(folder), *(image.stem for image in images)]),
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
        )
        try:
            while process.poll() is None:
                finished = sum(image.exists() for image in images)
                name = DAY[min(finished, len(DAY) - 1)].name
                yield Progress(finished / len(DAY), f"Rendering {TREE_COUNT:,} relightable trees: {name}")
                time.sleep(POLL_SECONDS)
        finally:
            process.kill()
            errors = process.communicate()[1]
        if not all(image.exists() for image in images):
            last = (errors.strip().splitlines() or [f"exit code {process.returncode}"])[-1]
            raise FileError(f'The forest in "{path}" was not rendered: {last}. Open the file in Blender and render it there.')
        cells = [_read_image(image) for image in images]
    title = f"{TREE_COUNT:,} instances of one relightable cloud at four times of day, rendered without Farfield"
    return draw_contact_sheet(title, [cells], [""], [[hour.name] for hour in DAY])


def frame_of_hour(index: int) -> int:
    """Return the frame of `DAY[index]`."""
    return 1 + FRAMES_PER_HOUR * index


def _render_command(arguments: list[str]) -> list[str]:
    script = str(environment.ROOT / "scripts" / "render_frames.py")
    if bpy.app.module:
        return [sys.executable, script, *arguments]
    return [bpy.app.binary_path, "--background", "--factory-startup", "--python", script, "--", *arguments]


def _read_image(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path), check_existing=False)
    try:
        return read_pixels(image)[..., :3].astype(np.float64)
    finally:
        bpy.data.images.remove(image)


def _isolate_collection(cloud: SceneCloud) -> bpy.types.Collection:
    """Replace the open file by one with nothing but the collection of `cloud`, its dependencies and its PBR material."""
    pbr = pbr_material(cloud.levels[0])
    with temporary_folder() as folder:
        path = str(folder / "cloud.blend")
        names = cloud.collection.name, pbr.name
        link_suns(cloud.levels[0], (), (0.0, 0.0, 0.0))
        try:
            bpy.data.libraries.write(path, {cloud.collection, pbr}, fake_user=True)
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            with bpy.data.libraries.load(path) as (_, appended):
                appended.collections, appended.materials = [names[0]], [names[1]]
        except (OSError, RuntimeError) as error:
            raise FileError(f'The cloud cannot be written to the temporary folder "{folder}": {error}. Free some disk space.') from error
        return appended.collections[0]


def _world_bounds(level: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return the minimum and maximum (3,) of a level in world space."""
    corners = np.array([level.matrix_basis @ mathutils.Vector(corner) for corner in level.bound_box])
    return corners.min(axis=0), corners.max(axis=0)


def _add_ground(scene: bpy.types.Scene, base: np.ndarray, width: float) -> None:
    mesh = bpy.data.meshes.new("Ground")
    half_side = 2000.0 * width
    corners = np.array(
        [(-half_side, -half_side, 0.0), (half_side, -half_side, 0.0), (half_side, half_side, 0.0), (-half_side, half_side, 0.0)]
    )
    mesh.from_pydata((base + corners).tolist(), [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("Ground")
    enable_nodes(material)
    principled = find_node(material.node_tree, "BSDF_PRINCIPLED")
    principled.inputs["Base Color"].default_value = (0.16, 0.18, 0.07, 1.0)
    principled.inputs["Roughness"].default_value = 1.0
    principled.inputs["Specular IOR Level"].default_value = 0.0
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("Ground", mesh))


def _add_sun(scene: bpy.types.Scene) -> bpy.types.Object:
    light = bpy.data.lights.new("Sun", "SUN")
    light.angle = SUN_ANGLE
    sun = bpy.data.objects.new("Sun", light)
    scene.collection.objects.link(sun)
    return sun


def _keyframe_day(scene: bpy.types.Scene, level: bpy.types.Object, sun: bpy.types.Object) -> None:
    """Insert keyframes for Sun light, World and the ambient light of the trees at every time of day."""
    scene.world = bpy.data.worlds.new("Sky")
    set_uniform_sky(scene.world)
    sky = find_node(scene.world.node_tree, "BACKGROUND").inputs["Color"]
    rotation = mathutils.Euler()
    for index, hour in enumerate(DAY):
        frame = frame_of_hour(index)
        rotation = mathutils.Vector(hour.sun_direction).to_track_quat("Z", "Y").to_euler("XYZ", rotation)
        sun.rotation_euler, sun.data.color, sun.data.energy = rotation, hour.color, hour.strength
        sky.default_value = (*hour.sky_radiance, 1.0)
        sun.keyframe_insert("rotation_euler", frame=frame)
        sun.data.keyframe_insert("color", frame=frame)
        sun.data.keyframe_insert("energy", frame=frame)
        sky.keyframe_insert("default_value", frame=frame)
        if needs_linked_suns(level):
            level[AMBIENT] = list(hour.sky_radiance)
            level.keyframe_insert(f'["{AMBIENT}"]', frame=frame)
    scene.frame_start, scene.frame_end = frame_of_hour(0), frame_of_hour(len(DAY) - 1)
    scene.frame_set(scene.frame_start)


def _set_up_camera(scene: bpy.types.Scene, position: np.ndarray) -> None:
    camera = bpy.data.cameras.new("Camera")
    camera.sensor_fit, camera.angle = "HORIZONTAL", float(FIELD_OF_VIEW)
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.collection.objects.link(scene.camera)
    backwards = np.array([0.0, -1.0, CAMERA_TILT])
    scene.camera.matrix_world = look_at_matrix(backwards / np.linalg.norm(backwards), position)
    camera.clip_start, camera.clip_end = 0.001 * position[2], 1e5


def _set_up_render(scene: bpy.types.Scene, width: int, samples: int) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, round(width * 9 / 16), 100
    render.use_persistent_data = True
    set_file_format(render.image_settings, "PNG")
    render.image_settings.color_mode = "RGB"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = samples, False, True
    cycles.max_bounces, cycles.transparent_max_bounces = 0, MAX_TRANSPARENT_BOUNCES
    scene.view_settings.view_transform = "Standard"
