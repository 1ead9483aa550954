"""The demo's photographs: a textured model photographed by virtual cameras with varying exposure, merged, and compared with the truth."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.rendering.render_scene import prepare_cycles
from farfield.addon.compat import set_file_format
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.imaging.metrics import crop_to_object, psnr, ssim
from farfield.addon.core.jobs.progress import Progress, StageClock, Steps, subprogress
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.photos.job import MergeJob, prepare
from lib.contact_sheet import draw_contact_sheet
from lib.demo_materials import create_material
from lib.studio import look_at_matrix, set_uniform_sky

CAMERA_COUNT = 8
MAX_EXPOSURE = 0.5  # stops
DISTANCE = 6.0  # scene units
FOCAL_LENGTH, VIEW_FOCAL_LENGTH = 75.0, 100.0  # millimeters, of photographs and of the square views
ELEVATIONS = (0.55, -0.3)  # radians, alternating
HELD_OUT = 6
HELD_OUT_ELEVATION = 0.2
PHOTOGRAPHING_END, MERGING_END = 0.4, 0.75  # fractions of the progress
NAME = "Monkey"


@dataclass(frozen=True)
class PhotosPreset:
    """The amount of work.

    Attributes:
        photograph_width: pixels.
        samples: of Cycles, in photographs and compared views.
        texture_size: texels per side.
        view_pixels: per side of the compared views.
        subdivisions: of the model.
    """

    photograph_width: int
    samples: int
    texture_size: int
    view_pixels: int
    subdivisions: int = 2


@dataclass
class PhotosDemo:
    """What was photographed and merged. truth, merged: views (H, W, 3) from directions without a camera, sRGB."""

    exposures: list[float]
    message: str
    photographs: list[np.ndarray]
    seconds: dict[str, float]
    truth: list[np.ndarray] = field(default_factory=list)
    merged: list[np.ndarray] = field(default_factory=list)

    def to_report(self) -> dict[str, Any]:
        """Return the figures for a JSON report."""
        scores = []
        for truth, merged in zip(self.truth, self.merged, strict=True):
            shown = (truth != truth[0, 0]).any(axis=2)  # the World is the same in the corner
            box = crop_to_object(shown.astype(np.float32))
            scores.append((psnr(truth[shown], merged[shown]), ssim(truth[box], merged[box])))
        return {
            "cameras": len(self.exposures),
            "exposures": [round(value, 3) for value in self.exposures],
            "message": self.message,
            "views": [{"psnr": round(first, 2), "ssim": round(second, 4)} for first, second in scores],
            "seconds": {name: round(value, 3) for name, value in self.seconds.items()},
        }

    def draw_sheet(self) -> np.ndarray:
        """Return a contact sheet (H, W, 3)."""
        count = len(self.truth)
        rows = [[center_square(image, len(self.truth[0])) for image in self.photographs[:count]], self.truth, self.merged]
        labels = [[f"photograph {index + 1} and", f"other view {index + 1}"] for index in range(count)]
        title = f"A texture from {len(self.exposures)} photographs whose exposures differ by up to one stop"
        return draw_contact_sheet(title, rows, ["photographs", "truth", "merged"], labels)


def photograph_and_merge(preset: PhotosPreset) -> Steps[PhotosDemo]:
    """Open a new scene, photograph a model, and merge the photographs into a texture for a copy of the model.

    Raises:
        FarfieldError: see `prepare` and its job.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    model = create_model(preset.subdivisions)
    scene.camera = cameras_at(scene, [(0.0, 0.0)], "Viewpoint")[0]
    prepare_cycles(scene, preset.samples, 8)
    scene.camera.data.type = "PERSP"
    scene.render.film_transparent = False
    scene.view_settings.view_transform = "Standard"
    scene.world = bpy.data.worlds.new("Sky")
    set_uniform_sky(scene.world)
    angles = [(2.0 * np.pi * index / CAMERA_COUNT, ELEVATIONS[index % 2]) for index in range(CAMERA_COUNT)]
    cameras = cameras_at(scene, angles, "Camera")
    exposures = np.random.default_rng(0).uniform(-MAX_EXPOSURE, MAX_EXPOSURE, CAMERA_COUNT).tolist()
    set_size(scene, preset.photograph_width, 3 * preset.photograph_width // 4)
    photographs = []
    clock = StageClock()
    with temporary_folder() as folder:
        for index, (camera, exposure) in enumerate(zip(cameras, exposures, strict=True)):
            yield Progress(PHOTOGRAPHING_END * index / CAMERA_COUNT, "Taking photographs")
            with clock.stage("photographs"):
                photographs.append(take_photograph(scene, camera, exposure, folder / f"photograph_{index + 1}.png"))
        job = prepare_merge(model, preset.texture_size)
        with clock.stage("merge"):
            message = yield from subprogress(run_job(job), PHOTOGRAPHING_END, MERGING_END)
        (target,) = [item for item in bpy.context.selected_objects if item.type == "MESH"]
        demo = PhotosDemo(exposures, message, photographs, clock.seconds)
        set_size(scene, preset.view_pixels, preset.view_pixels)
        with clock.stage("compare"):
            yield from subprogress(compare(scene, model, target, demo, folder / "view.png"), MERGING_END, 1.0)
    scene.camera = cameras[0]
    return demo


def create_model(subdivisions: int) -> bpy.types.Object:
    """Create a subdivided monkey without UV map that emits what a procedural material shows: the truth has no highlights."""
    bpy.ops.mesh.primitive_monkey_add()
    model = bpy.context.object
    model.name = NAME
    if subdivisions > 0:
        subdivision = model.modifiers.new("Subdivision", "SUBSURF")
        subdivision.levels = subdivision.render_levels = subdivisions
        bpy.ops.object.modifier_apply(modifier=subdivision.name)
    while model.data.uv_layers:
        model.data.uv_layers.remove(model.data.uv_layers[0])
    material, nodes, links, surface = create_material("Painted")
    coordinates = nodes.new("ShaderNodeTexCoord")
    cells, noise = nodes.new("ShaderNodeTexVoronoi"), nodes.new("ShaderNodeTexNoise")
    cells.inputs["Scale"].default_value, noise.inputs["Scale"].default_value = 9.0, 14.0
    noise.inputs["Detail"].default_value = 3.0
    mix = nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    mix.inputs["Factor"].default_value = 0.45
    colors = [socket for socket in mix.inputs if socket.type == "RGBA"]
    for node, color in ((cells, colors[0]), (noise, colors[1])):
        links.new(coordinates.outputs["Object"], node.inputs["Vector"])
        links.new(node.outputs["Color"], color)
    darkened = nodes.new("ShaderNodeMix")  # so that no photograph is overexposed
    darkened.data_type, darkened.blend_type = "RGBA", "MULTIPLY"
    darkened.inputs["Factor"].default_value = 1.0
    factors = [socket for socket in darkened.inputs if socket.type == "RGBA"]
    factors[1].default_value = (0.6, 0.5, 0.42, 1.0)
    links.new(next(socket for socket in mix.outputs if socket.type == "RGBA"), factors[0])
    links.new(next(socket for socket in darkened.outputs if socket.type == "RGBA"), surface.inputs["Emission Color"])
    make_emissive(surface)
    model.data.materials.append(material)
    return model


def make_emissive(surface: bpy.types.Node) -> None:
    """Let a Principled BSDF show its emission color alone."""
    surface.inputs["Base Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    surface.inputs["Specular IOR Level"].default_value = 0.0
    surface.inputs["Emission Strength"].default_value = 1.0


def cameras_at(scene: bpy.types.Scene, angles: list[tuple[float, float]], name: str) -> list[bpy.types.Object]:
    """Create cameras that look at the origin from azimuths and elevations in radians."""
    cameras = []
    for azimuth, elevation in angles:
        direction = np.array([np.sin(azimuth) * np.cos(elevation), -np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
        camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
        camera.data.lens = FOCAL_LENGTH
        camera.matrix_world = look_at_matrix(direction, DISTANCE * direction)
        scene.collection.objects.link(camera)
        cameras.append(camera)
    return cameras


def set_size(scene: bpy.types.Scene, width: int, height: int) -> None:
    """Set the size of renders in pixels."""
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100


def take_photograph(scene: bpy.types.Scene, camera: bpy.types.Object, exposure: float, path: Path) -> np.ndarray:
    """Render a photograph with an exposure in stops, pack it into the camera's background image, and return its pixels (H, W, 3)."""
    scene.camera = camera
    scene.view_settings.exposure = exposure
    pixels = render(scene, path)
    scene.view_settings.exposure = 0.0
    background = camera.data.background_images.new()
    background.image = bpy.data.images.load(str(path))
    background.image.pack()
    camera.data.show_background_images = True
    return pixels


def render(scene: bpy.types.Scene, path: Path) -> np.ndarray:
    """Render the active camera of the scene to a PNG file and return its pixels (H, W, 3), row 0 at the bottom."""
    set_file_format(scene.render.image_settings, "PNG")
    scene.render.image_settings.color_mode = "RGB"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    shape = image.size[1], image.size[0], 4
    bpy.data.images.remove(image)
    return pixels.reshape(shape)[..., :3].copy()


def prepare_merge(model: bpy.types.Object, size: int) -> MergeJob:
    """Hide the `model`, select a copy without material, and prepare the merge."""
    target = model.copy()
    target.data = model.data.copy()
    target.data.materials.clear()
    target.name = f"{NAME} from Photographs"
    bpy.context.scene.collection.objects.link(target)
    model.hide_render = True
    model.hide_set(True)
    bpy.context.view_layer.update()
    for item in bpy.context.view_layer.objects:
        item.select_set(item == target)
    bpy.context.view_layer.objects.active = target
    return prepare(bpy.context, PhotosSettings(size=size), has_maps=False)


def compare(scene: bpy.types.Scene, model: bpy.types.Object, target: bpy.types.Object, demo: PhotosDemo, path: Path) -> Steps[None]:
    """Render the model and its copy from directions without a camera to a file that is overwritten."""
    (material,) = target.data.materials
    emissive = material.copy()
    tree = emissive.node_tree
    surface = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    (link,) = surface.inputs["Base Color"].links
    tree.links.new(link.from_socket, surface.inputs["Emission Color"])
    tree.links.remove(surface.inputs["Base Color"].links[0])
    make_emissive(surface)
    target.data.materials[0] = emissive
    angles = [(2.0 * np.pi * (index + 0.5) / HELD_OUT, HELD_OUT_ELEVATION) for index in range(HELD_OUT)]
    cameras = cameras_at(scene, angles, "Other View")
    for index, camera in enumerate(cameras):
        yield Progress(index / HELD_OUT, "Comparing with the truth")
        camera.data.lens = VIEW_FOCAL_LENGTH
        scene.camera = camera
        for item, hidden, images in ((model, target, demo.truth), (target, model, demo.merged)):
            item.hide_render, hidden.hide_render = False, True
            images.append(render(scene, path))
    target.data.materials[0] = material
    target.hide_render, model.hide_render = False, True
    bpy.data.materials.remove(emissive)
    for camera in cameras:
        bpy.data.cameras.remove(camera.data)


def center_square(image: np.ndarray, size: int) -> np.ndarray:
    """Return the middle of an image (H, W, 3), scaled by area to `size` pixels per side; its height must be at least that."""
    height, width = image.shape[:2]
    square = image[:, (width - height) // 2 : (width + height) // 2]
    rows = (np.arange(size + 1) * height) // size
    sums = np.add.reduceat(np.add.reduceat(square, rows[:-1], axis=0), rows[:-1], axis=1)
    counts = np.diff(rows)
    return sums / (counts[:, None] * counts)[..., None]
