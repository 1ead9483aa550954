"""The material of landscapes: shader nodes that choose rock, soil or snow by the normal and the height, with noise of all sizes.

All colors and numbers are inputs of one node group, which the terrains of all tools share.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import bpy

from .node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

GROUP_NAME = "Farfield Ground"
GROUP_VERSION = 4
NO_WATER = -1e6  # scene units


@dataclass(frozen=True)
class Bumps:
    """Noise that shades the ground.

    Attributes:
        wavelength: of its first octave, relative to Bump Size.
        height: relative to Bump Size.
        octaves: each half as long as the one before.
        nearest: distance from which they are seen in full, relative to Bump Size; nearer, voxels have that shape.
        farthest: distance from which they are not seen, relative to Bump Size; they would be finer than pixels.
        contrast: how much darker hollows are than bumps.
    """

    wavelength: float
    height: float
    octaves: float
    nearest: float
    farthest: float
    contrast: float


BUMPS = (
    Bumps(110.0, 20.0, 5.0, 1200.0, 60_000.0, 0.8),
    Bumps(10.0, 3.0, 6.0, 0.0, 2500.0, 0.9),
    Bumps(0.8, 0.2, 5.0, 0.0, 160.0, 1.6),
)
SOFT_BUMPS = 0.3  # Height of bumps on soil and snow, relative to those on rock.
# Joints of rock: ridges of noise, longer upwards than across.
JOINTS, JOINT_ASPECT, JOINT_COLOR = Bumps(36.0, 7.0, 7.0, 0.0, 9000.0, 0.0), 0.35, 0.55
BREAKUP = 0.35  # How much bumps move the borders between layers, relative to the variation by noise.
STRATA_WARP = 0.35  # How far noise warps layers of rock, relative to the size of the noise.
WET_COLOR, WET_ROUGHNESS = 0.45, 0.35  # Of wet ground, relative to dry ground.
INPUTS = (
    ("Position", "Vector"), ("Normal", "Vector"), ("Rock", "Color"), ("Strata", "Color"), ("Scree", "Color"), ("Grass", "Color"),
    ("Undergrowth", "Color"), ("Sand", "Color"), ("Snow", "Color"), ("Water", "Color"), ("Rock Slope", "Float"),
    ("Scree Width", "Float"), ("Snow Height", "Float"), ("Sand Height", "Float"), ("Water Height", "Float"), ("Clarity", "Float"),
    ("Size", "Float"), ("Height Blend", "Float"), ("Height Noise", "Float"), ("Slope Blend", "Float"), ("Slope Noise", "Float"),
    ("Noise Scale", "Float"), ("Strata Scale", "Float"), ("Color Noise", "Float"), ("Roughness", "Float"), ("Bump Size", "Float"),
    ("Bump Strength", "Float"), ("Distant Bumps", "Float"),
)  # fmt: skip
OUTPUTS = ("Color", "Color"), ("Roughness", "Float"), ("Normal", "Vector")
LAYERS = ("Rock", "Strata", "Scree", "Grass", "Undergrowth", "Sand", "Snow")  # The inputs that are colors of the ground.
DEFAULTS = {
    "Rock": (0.17, 0.14, 0.115, 1.0),
    "Strata": (0.26, 0.225, 0.18, 1.0),
    "Scree": (0.2, 0.175, 0.15, 1.0),
    "Grass": (0.075, 0.095, 0.028, 1.0),
    "Undergrowth": (0.034, 0.048, 0.016, 1.0),
    "Sand": (0.36, 0.27, 0.16, 1.0),
    "Snow": (0.8, 0.83, 0.88, 1.0),
    "Rock Slope": 0.72,  # z of the normal below which the ground is rock
    "Scree Width": 0.07,  # how much larger z is where rock debris ends and soil begins
    "Water Height": NO_WATER,  # below it and a little above, the ground is wet
    "Water": (0.006, 0.035, 0.045, 1.0),  # color of deep water
    "Clarity": 4.0,  # depth at which 63 % of the color is that of deep water
    "Height Blend": 0.06,  # half the width of the blends at Sand Height and Snow Height, relative to Size
    "Height Noise": 0.7,  # variation of these heights, relative to Size
    "Slope Blend": 0.035,  # half the width of the blend at Rock Slope
    "Slope Noise": 0.35,  # variation of Rock Slope
    "Noise Scale": 6.0,  # noise features per Size
    "Strata Scale": 9.0,  # layers of rock per Size
    "Color Noise": 0.8,  # variation of the brightness by noise
    "Roughness": 0.9,
    "Bump Size": 1.0,  # length of bumps that shading adds between the voxels
    "Bump Strength": 1.0,
    "Distant Bumps": 1.0,  # how much of the large bumps there is, where distant ground has fewer samples
}


def add_ground(
    builder: NodeBuilder, position: bpy.types.NodeSocket, normal: bpy.types.NodeSocket, values: Mapping[str, SocketOrValue]
) -> bpy.types.NodeSocket:
    """Add the ground at a `position` relative to the terrain, with a `normal` in world space. Returns its shader.

    values: of its inputs, other than `DEFAULTS`.
    """
    group = builder.node("ShaderNodeGroup", {"node_tree": _ensure_ground_group(), "width": 200.0})
    for socket, value in (DEFAULTS | dict(values)).items():
        builder.connect(value, group.inputs[socket])
    builder.connect(position, group.inputs["Position"])
    builder.connect(normal, group.inputs["Normal"])
    principled = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(group.outputs["Color"], principled.inputs["Base Color"])
    builder.connect(group.outputs["Roughness"], principled.inputs["Roughness"])
    builder.connect(group.outputs["Normal"], principled.inputs["Normal"])
    return principled.outputs[0]


def _ensure_ground_group() -> bpy.types.NodeTree:
    return ensure_shared_group(GROUP_NAME, GROUP_VERSION, INPUTS, OUTPUTS, _fill_ground_group)


def _fill_ground_group(builder: NodeBuilder) -> None:
    for item in builder.tree.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name in DEFAULTS:
            item.default_value = DEFAULTS[item.name]
    inputs = builder.node("NodeGroupInput").outputs
    noise_scale = builder.math("DIVIDE", inputs["Noise Scale"], inputs["Size"])
    noise = add_noise(builder, inputs["Position"], noise_scale, 4.0)
    normal_z = builder.separate(builder.vector_transform(inputs["Normal"], "NORMAL", "WORLD", "OBJECT"))[2]
    position_z = builder.separate(inputs["Position"])[2]
    view_distance = builder.node("ShaderNodeCameraData").outputs["View Distance"]
    distance = builder.math("DIVIDE", view_distance, inputs["Bump Size"])
    bumps = _build_bumps(builder, inputs, distance)
    uneven = builder.math("ADD", builder.math("MULTIPLY", bumps.pattern, BREAKUP), noise)
    height_noise = builder.math("MULTIPLY", uneven, builder.math("MULTIPLY", inputs["Size"], inputs["Height Noise"]))
    height = builder.math("ADD", position_z, height_noise)
    normal_z = builder.math("ADD", normal_z, builder.math("MULTIPLY", uneven, inputs["Slope Noise"]))
    height_blend = builder.math("MULTIPLY", inputs["Size"], inputs["Height Blend"])
    is_open = _ramp(builder, uneven, 0.0, 0.12)
    ground = builder.mix(is_open, inputs["Undergrowth"], inputs["Grass"])
    above_sand = _ramp(builder, height, inputs["Sand Height"], height_blend)
    ground = builder.mix(above_sand, inputs["Sand"], ground)
    above_snow = _ramp(builder, height, inputs["Snow Height"], height_blend)
    ground = builder.mix(above_snow, ground, inputs["Snow"])
    start_of_scree = builder.math("ADD", inputs["Rock Slope"], inputs["Scree Width"])
    scree = builder.mix(above_snow, inputs["Scree"], inputs["Snow"])
    ground = builder.mix(_ramp(builder, normal_z, start_of_scree, inputs["Slope Blend"]), scree, ground)
    is_soil = _ramp(builder, normal_z, inputs["Rock Slope"], inputs["Slope Blend"])
    color = builder.mix(is_soil, _build_rock(builder, inputs, position_z, noise), ground)
    noise_factor = builder.math("ADD", builder.math("MULTIPLY", noise, inputs["Color Noise"]), 1.0)
    brightness = builder.math("MULTIPLY", noise_factor, bumps.brightness)
    joints = builder.math("MULTIPLY", _build_joints(builder, inputs, distance), builder.math("SUBTRACT", 1.0, is_soil))
    brightness = builder.math("MULTIPLY", brightness, builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", joints, JOINT_COLOR)))
    shore = builder.math("ADD", inputs["Water Height"], builder.math("MULTIPLY", inputs["Bump Size"], 2.0))
    is_dry = _ramp(
        builder, builder.math("ADD", position_z, builder.math("MULTIPLY", bumps.pattern, inputs["Bump Size"])), shore, inputs["Bump Size"]
    )
    brightness = builder.math("MULTIPLY", brightness, _between(builder, is_dry, WET_COLOR))
    output = builder.node("NodeGroupOutput")
    depth = builder.math("MAXIMUM", builder.math("SUBTRACT", inputs["Water Height"], position_z), 0.0)
    passed = builder.attenuate(builder.math("DIVIDE", depth, inputs["Clarity"]))
    builder.connect(builder.mix(passed, inputs["Water"], builder.vector("SCALE", color, brightness)), output.inputs["Color"])
    roughness = builder.math("MULTIPLY", inputs["Roughness"], _between(builder, is_dry, WET_ROUGHNESS))
    builder.connect(roughness, output.inputs["Roughness"])
    softness = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_soil, 1.0 - SOFT_BUMPS))
    joint_height = builder.math("MULTIPLY", joints, builder.math("MULTIPLY", inputs["Bump Size"], -JOINTS.height))
    bump = builder.node("ShaderNodeBump")
    builder.connect(inputs["Bump Strength"], bump.inputs["Strength"])
    builder.connect(builder.math("ADD", builder.math("MULTIPLY", bumps.height, softness), joint_height), bump.inputs["Height"])
    bump.inputs["Distance"].default_value = 1.0
    builder.connect(inputs["Normal"], bump.inputs["Normal"])
    builder.connect(bump.outputs["Normal"], output.inputs["Normal"])


def add_noise(builder: NodeBuilder, position: bpy.types.NodeSocket, scale: SocketOrValue, octaves: float) -> bpy.types.NodeSocket:
    """Return noise with a mean of 0 at a position."""
    noise = builder.node("ShaderNodeTexNoise")
    builder.connect(builder.vector("SCALE", position, scale), noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, octaves
    return builder.math("SUBTRACT", noise.outputs[0], 0.5)


def _build_rock(
    builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection, position_z: bpy.types.NodeSocket, noise: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Return the color of rock with its layers, which noise warps."""
    scale = builder.math("DIVIDE", inputs["Strata Scale"], inputs["Size"])
    layers = builder.node("ShaderNodeTexNoise", {"noise_dimensions": "1D"})
    warped = builder.math("MULTIPLY", noise, builder.math("DIVIDE", inputs["Size"], inputs["Noise Scale"]))
    warped = builder.math("ADD", position_z, builder.math("MULTIPLY", warped, STRATA_WARP))
    builder.connect(builder.math("MULTIPLY", warped, scale), layers.inputs["W"])
    layers.inputs["Scale"].default_value, layers.inputs["Detail"].default_value = 1.0, 4.0
    return builder.mix(_ramp(builder, layers.outputs[0], 0.5, 0.15), inputs["Rock"], inputs["Strata"])


def _build_joints(builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection, distance: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return how far the position is in a joint of rock, from 0 to 1. distance: to the viewer, relative to Bump Size."""
    stretched = builder.vector("MULTIPLY", inputs["Position"], (1.0, 1.0, JOINT_ASPECT))
    noise = _bump_noise(builder, inputs, stretched, JOINTS)
    ridge = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", builder.math("ABSOLUTE", noise), 5.0), True)
    return builder.math("MULTIPLY", ridge, _fade(builder, distance, JOINTS))


@dataclass(frozen=True)
class BumpSockets:
    """What bumps do to the ground.

    Attributes:
        height: a length.
        pattern: about -1 to 1, mean 0.
        brightness: a factor, which is less than 1 in hollows.
    """

    height: bpy.types.NodeSocket
    pattern: bpy.types.NodeSocket
    brightness: bpy.types.NodeSocket


def _build_bumps(builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection, distance: bpy.types.NodeSocket) -> BumpSockets:
    """Return the bumps at the position. distance: to the viewer, relative to Bump Size."""
    height, pattern, brightness = 0.0, 0.0, 1.0
    for bumps in BUMPS:
        seen = _fade(builder, distance, bumps)
        if bumps.nearest:
            seen = builder.math("MULTIPLY", seen, builder.math("DIVIDE", distance, bumps.nearest, True))
            seen = builder.math("MULTIPLY", seen, inputs["Distant Bumps"])
        bump = builder.math("MULTIPLY", _bump_noise(builder, inputs, inputs["Position"], bumps), seen)
        height = builder.math("ADD", builder.math("MULTIPLY", bump, builder.math("MULTIPLY", inputs["Bump Size"], bumps.height)), height)
        pattern = builder.math("ADD", bump, pattern)
        brightness = builder.math("ADD", builder.math("MULTIPLY", bump, bumps.contrast), brightness)
    return BumpSockets(height, pattern, brightness)


def _bump_noise(
    builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection, position: bpy.types.NodeSocket, bumps: Bumps
) -> bpy.types.NodeSocket:
    """Return the noise of bumps, with a mean of 0."""
    return add_noise(builder, position, builder.math("DIVIDE", 1.0 / bumps.wavelength, inputs["Bump Size"]), bumps.octaves)


def _fade(builder: NodeBuilder, distance: bpy.types.NodeSocket, bumps: Bumps) -> bpy.types.NodeSocket:
    """Return a number that falls from 1 at the viewer to 0 where bumps would be finer than pixels."""
    return builder.math("SUBTRACT", 1.0, builder.math("DIVIDE", distance, bumps.farthest), True)


def _between(builder: NodeBuilder, fraction: bpy.types.NodeSocket, low: float) -> bpy.types.NodeSocket:
    """Return a number between `low` and 1."""
    return builder.math("ADD", builder.math("MULTIPLY", fraction, 1.0 - low), low)


def _ramp(builder: NodeBuilder, value: SocketOrValue, center: SocketOrValue, half_width: SocketOrValue) -> bpy.types.NodeSocket:
    """Return a linear ramp from 0 at `center` - `half_width` to 1 at `center` + `half_width`."""
    width = builder.math("MULTIPLY", half_width, 2.0)
    return builder.math("ADD", builder.math("DIVIDE", builder.math("SUBTRACT", value, center), width), 0.5, True)
