"""A flight through a wooded valley that was made distance-ready: as it renders, and with each level in its own color."""

import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from PIL import Image

from lib import environment

environment.import_farfield()
sys.path.append(str(environment.ROOT / "benchmarks"))  # whose valley is shown

from distance_valley import FRAMES, ROCKS, ValleyOptions, build_valley

from farfield.addon.bridge.distance.chains import read_chains
from farfield.addon.core.distance.settings import DistanceSettings
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.distance.job import prepare
from farfield.addon.operators.job_run import run_job

TREES, HOUSES = 7000, 1
# Of the original and of levels, scene-linear.
COLORS = ((0.75, 0.06, 0.04), (0.9, 0.35, 0.03), (0.8, 0.7, 0.06), (0.2, 0.6, 0.08), (0.05, 0.4, 0.7), (0.25, 0.15, 0.7))
DURATION = 250  # Of a frame, in milliseconds.
ANIMATION_QUALITY = 60


def build_ready_valley(width: int, samples: int) -> str:
    """Build the valley in a new scene and make it ready. Returns the message of the job."""
    objects = build_valley(ValleyOptions(0, TREES, ROCKS, HOUSES, 0, width, samples))
    scene = bpy.context.scene
    message = run_to_end(run_job(prepare(scene, objects, DistanceSettings())))
    scene.cycles.use_denoising = True
    return message


def color_levels() -> None:
    """Give the materials of each level one color; their opacity stays."""
    for chain in read_chains():
        for number, collection in enumerate(chain.collections):
            for item in collection.objects:
                for slot in item.material_slots:
                    slot.link, slot.material = "OBJECT", _create_colored(slot.material, COLORS[min(number, len(COLORS) - 1)])


def _create_colored(material: bpy.types.Material, color: tuple[float, float, float]) -> bpy.types.Material:
    colored = material.copy()
    for node in colored.node_tree.nodes:
        for socket in node.inputs:
            if socket.name == "Base Color" or (socket.name == "Color" and node.type.startswith("BSDF_")):
                for link in list(socket.links):
                    colored.node_tree.links.remove(link)
                socket.default_value = (*color, 1.0)
    return colored


def render_frame(frame: int) -> np.ndarray:
    """Return the pixels (H, W, 3) uint8 of a frame, row 0 at the top."""
    scene = bpy.context.scene
    scene.frame_set(frame)
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "frame.png")
        bpy.ops.render.render(write_still=True)
        with Image.open(scene.render.filepath) as image:
            return np.array(image.convert("RGB"))


def render_still(path: Path) -> None:
    """Write the first frame to a PNG file, with its right half colored by level."""
    real = render_frame(1)
    color_levels()
    colored = render_frame(1)
    half = real.shape[1] // 2
    Image.fromarray(np.concatenate([real[:, :half], colored[:, half:]], axis=1)).save(path)


def render_flight(path: Path) -> None:
    """Write an animated WebP of the flight, as it renders and next to it its levels."""
    real = [render_frame(frame) for frame in range(1, FRAMES + 1)]
    color_levels()
    images = [Image.fromarray(np.concatenate([image, render_frame(1 + number)], axis=1)) for number, image in enumerate(real)]
    options = {"duration": DURATION, "loop": 0, "quality": ANIMATION_QUALITY, "method": 6}
    images[0].save(path, save_all=True, append_images=images[1:], **options)
