"""A forest of one relightable cloud as a file of its own, which nothing of Farfield is needed to render: a day in three frames.

The trees are instances of the cloud's collection. An instance reads the numbers of its lamps from the one object that it shows, so the
drivers stand there once, and each finds the lamps' directions in its own frame.
"""

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import mathutils
import numpy as np

import environment

environment.import_farfield()

import scene_files
from contact_sheet import contact_sheet
from farfield.addon.bridge.btf_clouds import light_with, plain_material
from farfield.addon.bridge.btf_materials import AMBIENT
from farfield.addon.bridge.images import pixels_of
from farfield.addon.compat import give_nodes, set_file_format
from farfield.addon.core.errors import FileError
from farfield.addon.core.progress import Progress, Steps
from farfield.addon.operators.billboards_clouds import StandingCloud
from studio import SUN_ANGLE, looking_along, paint_sky

TREES = 1000
SIZES = (0.8, 1.2)  # of the cloud
SPACING = 1.35  # between two trees, of the cloud's width
JITTER = 0.35  # of the spacing
NEAREST = 8.0  # row, in widths from the camera
EYE = 3.2  # height of the camera, in heights of the cloud
FIELD = np.radians(46.0)  # width of the camera's view
DIP = 0.17  # tangent of the angle that the camera looks down
MOST_TRANSPARENT_BOUNCES = 1024  # what Cycles takes: quads of many trees stand behind each other
FRAMES_BETWEEN = 40
POLL = 0.2  # seconds between two looks at the process that renders


@dataclass(frozen=True)
class Hour:
    """A time of day. towards_sun: a direction, the camera looks along +Y. colour, strength (W/m2): the sun's. sky: radiance."""

    name: str
    towards_sun: tuple[float, float, float]
    colour: tuple[float, float, float]
    strength: float
    sky: tuple[float, float, float]


DAY = (
    Hour("morning", (0.90, 0.25, 0.26), (1.0, 0.66, 0.38), 6.0, (0.30, 0.36, 0.48)),
    Hour("noon", (0.25, -0.45, 1.10), (1.0, 0.97, 0.92), 3.6, (0.40, 0.56, 0.82)),
    Hour("evening", (-0.92, -0.10, 0.19), (1.0, 0.45, 0.18), 6.0, (0.26, 0.20, 0.30)),
)


def write_forest(cloud: StandingCloud, path: Path, width: int, samples: int) -> None:
    """Write the `.blend` file `path`: a forest of `cloud`, which has one relightable level, on plain ground under one sun.

    Replaces all that is open. A picture of it is `width` pixels wide, with so many Cycles `samples` a pixel.

    Raises:
        FileError: when it cannot be written.
    """
    collection = _alone(cloud)
    scene = bpy.context.scene
    (level,) = collection.objects
    scene.collection.children.link(collection)
    low, high = _box(level)
    foot = np.array([*(0.5 * (low + high))[:2], low[2]])
    collection.instance_offset = foot
    tree_width, height = float(max((high - low)[:2])), float(high[2] - low[2])
    eye = foot + [0.0, -NEAREST * tree_width, EYE * height]
    plant(collection, foot, tree_width)
    _lay_ground(scene, foot, tree_width)
    sun = _sun(scene)
    light_with(level, [sun], DAY[0].sky)
    _pass_the_day(scene, level, sun)
    _set_up_camera(scene, eye)
    _set_up_render(scene, width, samples)
    scene_files.save_scene(path)


def plant(collection: bpy.types.Collection, foot: np.ndarray, width: float) -> list[bpy.types.Object]:
    """TREES instances of `collection`, turned and scaled at random, in jittered rows behind `foot` (3,) that widen with the view."""
    random = np.random.default_rng(0)
    made = []
    for place in places(random):
        item = bpy.data.objects.new("Tree", None)
        item.instance_type, item.instance_collection = "COLLECTION", collection
        item.empty_display_size = 0.1 * width
        item.location = foot + [*(width * place), 0.0]
        item.rotation_euler.z = random.uniform(0.0, 2.0 * np.pi)
        item.scale = [random.uniform(*SIZES)] * 3
        bpy.context.scene.collection.objects.link(item)
        made.append(item)
    return made


def places(random: np.random.Generator) -> np.ndarray:
    """Where the trees stand, (TREES, 2) in widths of a tree. The one in the middle of the first row, at the origin, is the cloud itself."""
    found: list[tuple[float, float]] = []
    depth = 0.0
    while len(found) < TREES:
        half = int(np.ceil(1.15 * np.tan(0.5 * FIELD) * (NEAREST + depth) / SPACING))
        found += [(SPACING * column, depth) for column in range(-half, half + 1) if column or depth]
        depth += SPACING
    return np.array(found[:TREES]) + JITTER * SPACING * random.uniform(-1.0, 1.0, (TREES, 2))


def render_day(path: Path) -> Steps[np.ndarray]:
    """Have a process of its own, which knows nothing of Farfield, render the hours of the forest in `path`; a sheet (H, W, 3) of them.

    Raises:
        FileError: when it cannot.
    """
    with tempfile.TemporaryDirectory(prefix="farfield-forest-") as folder:
        pictures = [Path(folder) / f"{frame_of(number)}.png" for number in range(len(DAY))]
        process = subprocess.Popen(
            _command([str(path), folder, *(picture.stem for picture in pictures)]),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
        )
        try:
            while process.poll() is None:
                done = sum(picture.exists() for picture in pictures)
                name = DAY[min(done, len(DAY) - 1)].name
                yield Progress(done / len(DAY), f"Rendering {TREES:,} relightable trees: {name}")
                time.sleep(POLL)
        finally:
            process.kill()
            said = process.communicate()[1]
        if not all(picture.exists() for picture in pictures):
            last = (said.strip().splitlines() or [f"exit code {process.returncode}"])[-1]
            raise FileError(f'The forest in "{path}" was not rendered: {last}. Open it in Blender and render it there.')
        cells = [_read(picture) for picture in pictures]
    title = f"{TREES:,} instances of one relightable cloud at three times of day, rendered from its file alone"
    return contact_sheet(title, [cells], [""], [[hour.name] for hour in DAY])


def frame_of(hour: int) -> int:
    """The frame of the file that shows the hour of that number in DAY."""
    return 1 + FRAMES_BETWEEN * hour


def _command(arguments: list[str]) -> list[str]:
    script = str(Path(__file__).with_name("render_frames.py"))
    if bpy.app.module:
        return [sys.executable, script, *arguments]
    return [bpy.app.binary_path, "--background", "--factory-startup", "--python", script, "--", *arguments]


def _read(path: Path) -> np.ndarray:
    picture = bpy.data.images.load(str(path), check_existing=False)
    try:
        return pixels_of(picture)[..., :3].astype(np.float64)
    finally:
        bpy.data.images.remove(picture)


def _alone(cloud: StandingCloud) -> bpy.types.Collection:
    """The collection of `cloud` with all that it needs, and its plain material, in an otherwise empty file."""
    plain = plain_material(cloud.levels[0])
    with tempfile.TemporaryDirectory(prefix="farfield-forest-") as folder:
        path = str(Path(folder) / "cloud.blend")
        names = cloud.collection.name, plain.name
        light_with(cloud.levels[0], (), (0.0, 0.0, 0.0))
        try:
            bpy.data.libraries.write(path, {cloud.collection, plain}, fake_user=True)
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            with bpy.data.libraries.load(path) as (_, appended):
                appended.collections, appended.materials = [names[0]], [names[1]]
        except (OSError, RuntimeError) as error:
            raise FileError(f'The temporary folder "{folder}" cannot hold the cloud: {error}. Free some space there.') from error
        return appended.collections[0]


def _box(level: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and highest corner (3,) of a level in world space."""
    corners = np.array([level.matrix_basis @ mathutils.Vector(corner) for corner in level.bound_box])
    return corners.min(axis=0), corners.max(axis=0)


def _lay_ground(scene: bpy.types.Scene, foot: np.ndarray, width: float) -> None:
    mesh = bpy.data.meshes.new("Ground")
    reach = 2000.0 * width
    corners = np.array([(-reach, -reach, 0.0), (reach, -reach, 0.0), (reach, reach, 0.0), (-reach, reach, 0.0)])
    mesh.from_pydata((foot + corners).tolist(), [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("Ground")
    give_nodes(material)
    surface = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    surface.inputs["Base Color"].default_value = (0.16, 0.18, 0.07, 1.0)
    surface.inputs["Roughness"].default_value = 1.0
    surface.inputs["Specular IOR Level"].default_value = 0.0
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("Ground", mesh))


def _sun(scene: bpy.types.Scene) -> bpy.types.Object:
    light = bpy.data.lights.new("Sun", "SUN")
    light.angle = SUN_ANGLE
    sun = bpy.data.objects.new("Sun", light)
    scene.collection.objects.link(sun)
    return sun


def _pass_the_day(scene: bpy.types.Scene, level: bpy.types.Object, sun: bpy.types.Object) -> None:
    """Key sun, sky and the even light of the trees for every hour."""
    scene.world = bpy.data.worlds.new("Sky")
    paint_sky(scene.world)
    sky = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND").inputs["Color"]
    turn = mathutils.Euler()
    for number, hour in enumerate(DAY):
        frame = frame_of(number)
        turn = mathutils.Vector(hour.towards_sun).to_track_quat("Z", "Y").to_euler("XYZ", turn)
        sun.rotation_euler, sun.data.color, sun.data.energy = turn, hour.colour, hour.strength
        sky.default_value = (*hour.sky, 1.0)
        level[AMBIENT] = list(hour.sky)
        sun.keyframe_insert("rotation_euler", frame=frame)
        sun.data.keyframe_insert("color", frame=frame)
        sun.data.keyframe_insert("energy", frame=frame)
        sky.keyframe_insert("default_value", frame=frame)
        level.keyframe_insert(f'["{AMBIENT}"]', frame=frame)
    scene.frame_start, scene.frame_end = frame_of(0), frame_of(len(DAY) - 1)
    scene.frame_set(scene.frame_start)


def _set_up_camera(scene: bpy.types.Scene, eye: np.ndarray) -> None:
    camera = bpy.data.cameras.new("Camera")
    camera.sensor_fit, camera.angle = "HORIZONTAL", float(FIELD)
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.collection.objects.link(scene.camera)
    backwards = np.array([0.0, -1.0, DIP])
    scene.camera.matrix_world = looking_along(backwards / np.linalg.norm(backwards), eye)
    camera.clip_start, camera.clip_end = 0.001 * eye[2], 1e5


def _set_up_render(scene: bpy.types.Scene, width: int, samples: int) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, round(width * 9 / 16), 100
    render.use_persistent_data = True
    set_file_format(render.image_settings, "PNG")
    render.image_settings.color_mode = "RGB"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = samples, False, True
    cycles.max_bounces, cycles.transparent_max_bounces = 0, MOST_TRANSPARENT_BOUNCES
    scene.view_settings.view_transform = "Standard"
