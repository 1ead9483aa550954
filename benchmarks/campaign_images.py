"""Random images in Blender for campaigns: of 8 bits and floats, colors and data, tiles, sequences, missing and damaged files, and masks."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import bpy
import campaign_inputs
import numpy as np

import image_data
import random_images
import random_inputs

SIDES = (24, 33)  # few, so that images and masks often have the same size
COLOR_SPACES = ("sRGB", "Non-Color", "Linear Rec.709")
ALPHA_MODES = ("STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE")
FIRST_TILE = 1001


def add_images(random: Random, folder: Path) -> None:
    """Add random images to the open file. Their files are written to `folder`."""
    for _ in range(random.choice((0, 2, 3, 3, 4))):
        with suppress(RuntimeError, TypeError):  # Blender refuses a damaged file, or has no such property for this image
            image = random.choice(MAKERS)(random, folder)
            image.alpha_mode = random.choice(ALPHA_MODES)
            if random.random() < 0.3:
                image.colorspace_settings.name = random.choice(COLOR_SPACES)
            image.use_fake_user = random.random() < 0.7
    if random.random() < 0.3:
        _add_normal_map(random)


def random_image_properties(random: Random, folder: Path) -> dict[str, Any]:
    """Return the properties of an operator that name images: existing ones, sometimes missing ones or none."""
    names = [image.name for image in bpy.data.images]

    def choose(missing: float) -> str:
        return random.choice(names) if names and random.random() > missing else random.choice(("", "missing", "line\nbreak", "x" * 200))

    properties = {"image": choose(0.1), "mask_image": choose(0.1), "mask": random.choice(("image", "image", "alpha", "color"))}
    properties |= {name: choose(0.1) if random.random() < 0.2 else "" for name in ("source_mask", "barriers")}
    properties["output_folder"] = random.choice(("", "//frames", str(folder / "frames"), str(folder), str(folder / "missing" / "frames")))
    return properties


def _fill(random: Random, image: bpy.types.Image) -> None:
    """Give an image noise, a mask, or values of one color, as floats sometimes not finite; sometimes with holes in its alpha."""
    width, height = image.size
    generator = np.random.default_rng(random.getrandbits(32))
    mask = random_images.random_mask(random, (height, width)) / 255.0
    values = np.ones((height, width, image.channels), np.float32)
    choice = random.random()
    values[..., :3] = generator.random((height, width, 1)) if choice < 0.4 else mask[..., None] if choice < 0.85 else 0.5
    if image.channels == 4 and random.random() < 0.3:
        values[..., 3] = 1.0 - random_images.random_mask(random, (height, width)) / 255.0
    if image.is_float and random.random() < 0.2:
        values[generator.integers(height), generator.integers(width)] = random.choice(random_images.SPECIAL_VALUES)
    image.pixels.foreach_set(values.ravel())
    image.update()


def _generated(random: Random, _folder: Path) -> bpy.types.Image:
    width, height = random.choice(SIDES), random.choice((*SIDES, 3))
    image = bpy.data.images.new(
        random_inputs.random_name(random), width, height, alpha=random.random() < 0.6, float_buffer=random.random() < 0.4
    )
    _fill(random, image)
    if random.random() < 0.5:
        image.pack()
    return image


def _tiled(random: Random, _folder: Path) -> bpy.types.Image:
    image = bpy.data.images.new(random_inputs.random_name(random), *(random.choice(SIDES) for _ in range(2)), tiled=True)
    _fill(random, image)
    for number in random.sample(range(FIRST_TILE + 1, FIRST_TILE + 20), random.choice((0, 1, 2))):
        image.tiles.new(number)
    if random.random() < 0.7:
        image.pack()
    return image


def _from_file(random: Random, folder: Path) -> bpy.types.Image:
    path = random.choice(campaign_inputs.write_images(random, folder))
    image = bpy.data.images.load(str(path))
    if random.random() < 0.3:
        path.unlink()  # Blender has not read the pixels yet
    return image


def _sequence(random: Random, folder: Path) -> bpy.types.Image:
    frames = folder / f"sequence {random.randrange(1000)}"
    frames.mkdir(exist_ok=True)
    size = (random.choice(SIDES), random.choice(SIDES))
    for number in random.sample(range(1, 9), random.choice((1, 2, 3))):
        generator = np.random.default_rng(random.getrandbits(32))
        stored = generator.integers(0, 256, (*(size if random.random() < 0.9 else (9, 7)), 3), np.uint8)
        image_data.write_image(frames / f"frame_{number:04d}.png", stored)
    image = bpy.data.images.load(str(random.choice(sorted(frames.iterdir()))))
    image.source = "SEQUENCE"
    return image


def _special(random: Random, _folder: Path) -> bpy.types.Image:
    image = bpy.data.images.new(random_inputs.random_name(random), 24, 24)
    image.source = random.choice(("VIEWER", "MOVIE", "FILE", "SEQUENCE"))
    return image


def _add_normal_map(random: Random) -> None:
    """Use one of the images as a normal map in a new material."""
    images = list(bpy.data.images)
    material = bpy.data.materials.new(random_inputs.random_name(random))
    if not images or material.node_tree is None:
        return
    nodes = material.node_tree.nodes
    texture, normal_map = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeNormalMap")
    texture.image = random.choice(images)
    material.node_tree.links.new(texture.outputs["Color"], normal_map.inputs["Color"])


MAKERS: tuple[Callable[[Random, Path], bpy.types.Image], ...] = (
    _generated, _generated, _generated, _generated, _generated, _tiled, _from_file, _sequence, _special,
)  # fmt: skip
