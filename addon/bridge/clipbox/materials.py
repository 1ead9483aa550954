"""The terrain material: shader nodes that select the ground by slope and height, with noise and a box-projected grain texture."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import FileError
from ..imaging.images import create_image
from ..shading.node_builder import NodeBuilder, SocketOrValue, create_node_material, ensure_shared_group
from ..shading.solid_view import show_color

GROUP_NAME = "Farfield Ground"
GROUP_VERSION = 2
GRAIN_IMAGE = "Farfield Grain"
SNOW_LINE = 0.3  # default height of snow above the upper height, relative to the size of the terrain
MIN_SIZE = 1e-3  # scene units, for a flat terrain
# Bumps of the ground: wavelength and height relative to Bump Size, octaves, and how far away they are seen. Farther away they would be
# finer than pixels.
BUMPS = (10.0, 3.0, 6.0, 1500.0), (0.8, 0.2, 5.0, 120.0)
SOFT_BUMPS = 0.35  # Height of bumps on soil, relative to those on rock.
BUMP_COLOR = 0.8  # How much darker hollows are than bumps.
INPUTS = (
    ("Position", "Vector"), ("Grain", "Color"), ("Rock", "Color"), ("Grass", "Color"), ("Sand", "Color"), ("Snow", "Color"),
    ("Rock Slope", "Float"), ("Snow Height", "Float"), ("Sand Height", "Float"), ("Size", "Float"), ("Height Blend", "Float"),
    ("Height Noise", "Float"), ("Slope Blend", "Float"), ("Slope Noise", "Float"), ("Noise Scale", "Float"), ("Grain Strength", "Float"),
    ("Grain Offset", "Float"), ("Color Noise", "Float"), ("Roughness", "Float"), ("Bump Size", "Float"), ("Bump Strength", "Float"),
)  # fmt: skip
OUTPUTS = ("Color", "Color"), ("Roughness", "Float"), ("Normal", "Vector")
DEFAULTS = {
    "Rock": (0.17, 0.14, 0.115, 1.0),
    "Grass": (0.075, 0.11, 0.03, 1.0),
    "Sand": (0.36, 0.27, 0.16, 1.0),
    "Snow": (0.8, 0.83, 0.88, 1.0),
    "Rock Slope": 0.72,  # z of the normal below which the ground is rock
    "Height Blend": 0.12,  # half the width of the blends at Sand Height and Snow Height, relative to Size
    "Height Noise": 0.6,  # variation of these heights, relative to Size
    "Slope Blend": 0.07,  # half the width of the blend at Rock Slope
    "Slope Noise": 0.35,  # variation of Rock Slope
    "Noise Scale": 6.0,  # noise features per Size
    "Grain Strength": 0.7,  # factor of the grain texture, which varies the brightness
    "Grain Offset": 0.65,  # brightness added to it
    "Color Noise": 0.8,  # variation of the brightness by noise
    "Roughness": 0.9,
    "Bump Size": 1.0,  # length of bumps that shading adds between the voxels
    "Bump Strength": 1.0,
}
MEADOW, DRY_GRASS = (0.09, 0.12, 0.035, 1.0), (0.2, 0.16, 0.075, 1.0)
RED_ROCK, DESERT_SAND = (0.3, 0.135, 0.07, 1.0), (0.5, 0.34, 0.19, 1.0)
DEFAULTS_BY_TERRAIN = {  # Other values than DEFAULTS.
    "forest": {  # Steep ground is foliage.
        "Rock": (0.045, 0.075, 0.018, 1.0), "Snow": (0.06, 0.09, 0.025, 1.0), "Sand": (0.12, 0.105, 0.05, 1.0)
    },
    "alps": {"Rock": (0.2, 0.185, 0.17, 1.0), "Sand": (0.06, 0.09, 0.03, 1.0), "Rock Slope": 0.8},
    "hills": {"Snow": MEADOW, "Sand": (0.055, 0.085, 0.025, 1.0), "Rock Slope": 0.62},
    "canyon": {"Rock": RED_ROCK, "Grass": DRY_GRASS, "Snow": DRY_GRASS, "Sand": (0.36, 0.2, 0.11, 1.0)},
    "mesas": {"Rock": RED_ROCK, "Grass": (0.34, 0.2, 0.1, 1.0), "Snow": DRY_GRASS, "Sand": (0.42, 0.24, 0.13, 1.0)},
    "dunes": {"Rock": (0.46, 0.3, 0.16, 1.0), "Grass": DESERT_SAND, "Snow": DESERT_SAND, "Sand": DESERT_SAND, "Color Noise": 0.3},
}  # fmt: skip


@dataclass(frozen=True)
class Grain:
    """The image of grains.

    Attributes:
        resolution: pixels per side.
        min_frequency: waves per image; lower frequencies have the amplitude of this one.
        falloff: exponent of the spectrum.
        deviation: standard deviation of the gray values.
        tile_size: side of one repetition, relative to the size of the terrain.
        blend: width of the blend between the three projections.
    """

    resolution: int = 256
    min_frequency: float = 3.0
    falloff: float = 0.9
    deviation: float = 0.22
    tile_size: float = 0.12
    blend: float = 0.35


GRAIN = Grain()


@dataclass(frozen=True)
class GroundImage:
    """An image of the ground from above, centered on x = y = 0 of the terrain.

    path: the file. size: length of its longest side, scene units. origin: (3,) terrain position at the root.
    """

    path: Path
    size: float
    origin: np.ndarray


def create_terrain_material(
    name: str,
    root: bpy.types.Object,
    low: float,
    high: float,
    voxel_size: float,
    ground_image: GroundImage | None = None,
    terrain: str = "",
) -> bpy.types.Material:
    """Create a material for terrain below `root`, most of which lies between the heights `low` and `high`, scene units above the root.

    All colors and numbers are inputs of its node group. voxel_size: of the smallest voxels; shading adds bumps between them. A
    `ground_image` replaces all ground colors. terrain: its kind.

    Raises:
        FileError: the ground image cannot be read.
    """
    size = max(0.5 * (high - low), MIN_SIZE)
    material, builder = create_node_material(name)
    position = builder.node("ShaderNodeTexCoord", {"object": root}).outputs["Object"]
    grain_position = builder.vector("SCALE", position, 1.0 / (GRAIN.tile_size * size))
    grain_position.node.label = "Grain Scale"
    grain = builder.node(
        "ShaderNodeTexImage",
        {
            "image": _ensure_grain_image(), "projection": "BOX", "projection_blend": GRAIN.blend, "extension": "REPEAT", "label": "Grain"
        },
    )  # fmt: skip
    builder.connect(grain_position, grain.inputs["Vector"])
    group = builder.node("ShaderNodeGroup", {"node_tree": _ensure_ground_group(), "width": 200.0})
    values = DEFAULTS | DEFAULTS_BY_TERRAIN.get(terrain, {})
    for socket, value in values.items():
        group.inputs[socket].default_value = value
    show_color(material, values["Grass"])
    group.inputs["Size"].default_value, group.inputs["Bump Size"].default_value = size, voxel_size
    group.inputs["Snow Height"].default_value, group.inputs["Sand Height"].default_value = high + SNOW_LINE * size, low
    if ground_image is not None:
        color = _project_ground_image(builder, position, ground_image)
        for socket in ("Rock", "Grass", "Sand", "Snow"):
            builder.connect(color, group.inputs[socket])
    builder.connect(position, group.inputs["Position"])
    builder.connect(grain.outputs["Color"], group.inputs["Grain"])
    principled = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(group.outputs["Color"], principled.inputs["Base Color"])
    builder.connect(group.outputs["Roughness"], principled.inputs["Roughness"])
    builder.connect(group.outputs["Normal"], principled.inputs["Normal"])
    builder.connect(principled.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    builder.arrange()
    return material


def _project_ground_image(builder: NodeBuilder, position: bpy.types.NodeSocket, ground_image: GroundImage) -> bpy.types.NodeSocket:
    """Return the color of a ground image at a `position` relative to the root."""
    try:
        image = bpy.data.images.load(str(ground_image.path), check_existing=True)
    except RuntimeError as error:
        raise FileError(f'The image "{ground_image.path}" cannot be read; check the path.') from error
    width, height = image.size
    if not (width and height):
        raise FileError(f'The file "{ground_image.path}" is not an image that Blender supports.')
    size = np.array([width, height]) * ground_image.size / max(width, height)
    centered_uv = builder.vector("MULTIPLY", builder.vector("ADD", position, ground_image.origin.tolist()), (*(1.0 / size).tolist(), 0.0))
    node = builder.node("ShaderNodeTexImage", {"image": image, "extension": "EXTEND", "label": "Ground Image"})
    builder.connect(builder.vector("ADD", centered_uv, (0.5, 0.5, 0.0)), node.inputs["Vector"])
    return node.outputs["Color"]


def _ensure_ground_group() -> bpy.types.NodeTree:
    return ensure_shared_group(GROUP_NAME, GROUP_VERSION, INPUTS, OUTPUTS, _fill_ground_group)


def _fill_ground_group(builder: NodeBuilder) -> None:
    for item in builder.tree.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name in DEFAULTS:
            item.default_value = DEFAULTS[item.name]
    inputs = builder.node("NodeGroupInput").outputs
    noise = builder.node("ShaderNodeTexNoise")
    noise_scale = builder.math("DIVIDE", inputs["Noise Scale"], inputs["Size"])
    builder.connect(builder.vector("SCALE", inputs["Position"], noise_scale), noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, 4.0
    centered_noise = builder.math("SUBTRACT", noise.outputs[0], 0.5)
    normal_z = builder.separate(builder.node("ShaderNodeNewGeometry").outputs["Normal"])[2]
    height = builder.separate(inputs["Position"])[2]
    height_noise = builder.math("MULTIPLY", centered_noise, builder.math("MULTIPLY", inputs["Size"], inputs["Height Noise"]))
    height = builder.math("ADD", height, height_noise)
    normal_z = builder.math("ADD", normal_z, builder.math("MULTIPLY", centered_noise, inputs["Slope Noise"]))
    above_sand = _ramp(builder, height, inputs["Sand Height"], builder.math("MULTIPLY", inputs["Size"], inputs["Height Blend"]))
    ground = builder.mix(above_sand, inputs["Sand"], inputs["Grass"])
    above_snow = _ramp(builder, height, inputs["Snow Height"], builder.math("MULTIPLY", inputs["Size"], inputs["Height Blend"]))
    ground = builder.mix(above_snow, ground, inputs["Snow"])
    is_soil = _ramp(builder, normal_z, inputs["Rock Slope"], inputs["Slope Blend"])
    color = builder.mix(is_soil, inputs["Rock"], ground)
    bumps, hollows = _build_bumps(builder, inputs)
    bumps = builder.math("MULTIPLY", bumps, builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_soil, 1.0 - SOFT_BUMPS)))
    brightness = builder.vector("ADD", builder.vector("SCALE", inputs["Grain"], inputs["Grain Strength"]), inputs["Grain Offset"])
    noise_factor = builder.math("ADD", builder.math("MULTIPLY", centered_noise, inputs["Color Noise"]), 1.0)
    brightness = builder.vector("SCALE", brightness, builder.math("MULTIPLY", noise_factor, hollows))
    output = builder.node("NodeGroupOutput")
    builder.connect(builder.vector("MULTIPLY", color, brightness), output.inputs["Color"])
    builder.connect(inputs["Roughness"], output.inputs["Roughness"])
    bump = builder.node("ShaderNodeBump")
    builder.connect(inputs["Bump Strength"], bump.inputs["Strength"])
    builder.connect(bumps, bump.inputs["Height"])
    bump.inputs["Distance"].default_value = 1.0
    builder.connect(bump.outputs["Normal"], output.inputs["Normal"])


def _build_bumps(builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Return the height of bumps at the position, a length, and a factor of the brightness, which is less than 1 in hollows."""
    distance = builder.node("ShaderNodeCameraData").outputs["View Distance"]
    height, factor = 0.0, 1.0
    for wavelength, relative_height, octaves, reach in BUMPS:
        noise = builder.node("ShaderNodeTexNoise")
        scale = builder.math("DIVIDE", 1.0 / wavelength, inputs["Bump Size"])
        builder.connect(builder.vector("SCALE", inputs["Position"], scale), noise.inputs["Vector"])
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, octaves
        seen = builder.math("DIVIDE", distance, builder.math("MULTIPLY", inputs["Bump Size"], reach))
        seen = builder.math("SUBTRACT", 1.0, seen, True)
        bump = builder.math("MULTIPLY", builder.math("SUBTRACT", noise.outputs[0], 0.5), seen)
        length = builder.math("MULTIPLY", inputs["Bump Size"], relative_height)
        height = builder.math("ADD", builder.math("MULTIPLY", bump, length), height)
        factor = builder.math("ADD", builder.math("MULTIPLY", bump, BUMP_COLOR), factor)
    return height, factor


def _ramp(builder: NodeBuilder, value: SocketOrValue, center: SocketOrValue, half_width: SocketOrValue) -> bpy.types.NodeSocket:
    """Return a linear ramp from 0 at `center` - `half_width` to 1 at `center` + `half_width`."""
    width = builder.math("MULTIPLY", half_width, 2.0)
    return builder.math("ADD", builder.math("DIVIDE", builder.math("SUBTRACT", value, center), width), 0.5, True)


def _ensure_grain_image() -> bpy.types.Image:
    """Return a tileable gray image of grains of all sizes, which all terrains of the file share."""
    for image in bpy.data.images:
        if image.name.startswith(GRAIN_IMAGE) and image.library is None and image.size[0] == GRAIN.resolution:
            return image
    spectrum = np.fft.rfft2(np.random.default_rng(1).normal(size=(GRAIN.resolution, GRAIN.resolution)))
    frequency = np.hypot(np.fft.fftfreq(GRAIN.resolution)[:, None], np.fft.rfftfreq(GRAIN.resolution)) * GRAIN.resolution
    gray = np.fft.irfft2(spectrum / np.maximum(frequency, GRAIN.min_frequency) ** GRAIN.falloff)
    gray = np.clip(0.5 + GRAIN.deviation * (gray - gray.mean()) / gray.std(), 0.0, 1.0)
    pixels = np.ones((GRAIN.resolution, GRAIN.resolution, 4), np.float32)
    pixels[..., :3] = gray[..., None]
    return create_image(GRAIN_IMAGE, pixels, is_data=True)
