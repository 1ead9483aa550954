"""The material of landscapes: shader nodes that choose rock, soil or snow by the normal and the height, with noise of all sizes.

All colors and numbers are inputs of one node group, which the terrains of all tools share.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import bpy

from .ground_detail import GroundDetail, add_noise, between, ramp
from .node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

GROUP_NAME = "Farfield Ground"
GROUP_VERSION = 5
NO_WATER = -1e6  # scene units


BREAKUP = 0.35  # How much bumps move the borders between layers, relative to the variation by noise.
WET_COLOR, WET_ROUGHNESS = 0.45, 0.35  # Of wet ground, relative to dry ground.
SMOOTH_CONTRAST = 0.35  # Of bumps on sand and snow, relative to that on other ground.
ROCK_EVENNESS = 0.7  # How far rock is from the contrast of other ground to that of sand, since it has cracks.
PATCH_WAVELENGTH, PATCH_OCTAVES = 38.0, 3  # Of dry grass, meters.
STREAK_WAVELENGTH, STREAK_ASPECT, STREAK_COLOR = 5.0, 0.07, 1.1  # Of stains that run down rock: meters, width by height, contrast.
STONE_RISE = 0.1  # By how much z of the normal stones reach beyond the border of rock debris.
STONE_SHADES, STONE_SHADE = (0.35, 0.85), 0.55  # Brightness of stones, and the factor of it between them.
RIPPLE_STEEPNESS = 0.8  # z of the normal below which the wind makes no ripples.
LEE_RIPPLES = 0.3  # Strength of ripples behind the crests of dunes, relative to that on the side of the wind, which blows along x.
CALM_RIPPLES = 0.35  # Strength of ripples in some patches, relative to that in others.
INPUTS = (
    ("Position", "Vector"), ("Normal", "Vector"), ("Rock", "Color"), ("Strata", "Color"), ("Scree", "Color"), ("Grass", "Color"),
    ("Undergrowth", "Color"), ("Dry Grass", "Color"), ("Sand", "Color"), ("Snow", "Color"), ("Water", "Color"), ("Rock Slope", "Float"),
    ("Scree Width", "Float"), ("Snow Height", "Float"), ("Sand Height", "Float"), ("Water Height", "Float"), ("Clarity", "Float"),
    ("Size", "Float"), ("Height Blend", "Float"), ("Height Noise", "Float"), ("Slope Blend", "Float"), ("Slope Noise", "Float"),
    ("Noise Scale", "Float"), ("Strata Scale", "Float"), ("Color Noise", "Float"), ("Roughness", "Float"), ("Bump Size", "Float"),
    ("Bump Strength", "Float"), ("Distant Bumps", "Float"), ("Meter", "Float"), ("Stones", "Float"), ("Ripples", "Float"),
)  # fmt: skip
OUTPUTS = ("Color", "Color"), ("Roughness", "Float"), ("Normal", "Vector")
LAYERS = ("Rock", "Strata", "Scree", "Grass", "Undergrowth", "Dry Grass", "Sand", "Snow")  # The inputs that are colors of the ground.
DEFAULTS = {
    "Rock": (0.17, 0.14, 0.115, 1.0),
    "Strata": (0.26, 0.225, 0.18, 1.0),
    "Scree": (0.2, 0.175, 0.15, 1.0),
    "Grass": (0.075, 0.095, 0.028, 1.0),
    "Undergrowth": (0.034, 0.048, 0.016, 1.0),
    "Dry Grass": (0.15, 0.14, 0.05, 1.0),
    "Sand": (0.36, 0.27, 0.16, 1.0),
    "Snow": (0.8, 0.83, 0.88, 1.0),
    "Rock Slope": 0.72,  # z of the normal below which the ground is rock
    "Scree Width": 0.07,  # how much larger z is where rock debris ends and soil begins
    "Water Height": NO_WATER,  # below it and a little above, the ground is wet
    "Water": (0.006, 0.035, 0.045, 1.0),  # color of deep water
    "Clarity": 4.0,  # depth at which 63 % of the color is that of deep water
    "Height Blend": 0.02,  # half the width of the blends at Sand Height and Snow Height, relative to Size
    "Height Noise": 0.7,  # variation of these heights, relative to Size
    "Slope Blend": 0.015,  # half the width of the blend at Rock Slope
    "Slope Noise": 0.35,  # variation of Rock Slope
    "Noise Scale": 6.0,  # noise features per Size
    "Strata Scale": 9.0,  # layers of rock per Size
    "Color Noise": 0.8,  # variation of the brightness by noise
    "Roughness": 0.9,
    "Bump Size": 1.0,  # length of bumps that shading adds between the voxels
    "Bump Strength": 1.0,
    "Distant Bumps": 1.0,  # how much of the large bumps there is, where distant ground has fewer samples
    "Meter": 1.0,  # length of a meter, of which stones, cracks and ripples have their sizes
    "Stones": 0.03,  # fraction of the stones of rock debris that also lie on level ground
    "Ripples": 0.0,  # height of ripples that the wind makes of sand
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
    detail = GroundDetail(builder, inputs)
    noise = add_noise(builder, inputs["Position"], builder.math("DIVIDE", inputs["Noise Scale"], inputs["Size"]), 3.0)
    layers = _mix_layers(builder, inputs, detail, noise)
    shore = builder.math("ADD", inputs["Water Height"], builder.math("MULTIPLY", inputs["Bump Size"], 2.0))
    position_z = builder.separate(inputs["Position"])[2]
    uneven_z = builder.math("ADD", position_z, builder.math("MULTIPLY", detail.pattern, inputs["Bump Size"]))
    is_dry = ramp(builder, uneven_z, shore, inputs["Bump Size"])
    color = builder.vector("SCALE", layers.color, between(builder, is_dry, WET_COLOR))
    output = builder.node("NodeGroupOutput")
    depth = builder.math("MAXIMUM", builder.math("SUBTRACT", inputs["Water Height"], position_z), 0.0)
    passed = builder.attenuate(builder.math("DIVIDE", depth, inputs["Clarity"]))
    builder.connect(builder.mix(passed, inputs["Water"], color), output.inputs["Color"])
    roughness = builder.math("MULTIPLY", inputs["Roughness"], between(builder, is_dry, WET_ROUGHNESS))
    builder.connect(roughness, output.inputs["Roughness"])
    builder.connect(detail.add_normal(layers.is_rock, layers.is_stone, layers.has_ripples), output.inputs["Normal"])


@dataclass(frozen=True)
class Layers:
    """The layers of the ground at a position, mixed.

    Attributes:
        color: of all.
        is_rock, is_stone: fractions of rock and of stones on the ground.
        has_ripples: strength of ripples of sand.
    """

    color: bpy.types.NodeSocket
    is_rock: bpy.types.NodeSocket
    is_stone: bpy.types.NodeSocket
    has_ripples: bpy.types.NodeSocket


def _mix_layers(builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection, detail: GroundDetail, noise: bpy.types.NodeSocket) -> Layers:
    """Choose the layers by the height and the normal. What is higher in the detail of a layer reaches farther beyond its border.

    noise: variation by position, mean 0.
    """
    normal_x, _, plain_z = builder.separate(builder.vector_transform(inputs["Normal"], "NORMAL", "WORLD", "OBJECT"))
    uneven = builder.math("ADD", builder.math("MULTIPLY", detail.pattern, BREAKUP), noise)
    height_noise = builder.math("MULTIPLY", uneven, builder.math("MULTIPLY", inputs["Size"], inputs["Height Noise"]))
    height = builder.math("ADD", builder.separate(inputs["Position"])[2], height_noise)
    normal_z = builder.math("ADD", plain_z, builder.math("MULTIPLY", uneven, inputs["Slope Noise"]))
    height_blend = builder.math("MULTIPLY", inputs["Size"], inputs["Height Blend"])

    patches = detail.noise(PATCH_WAVELENGTH, PATCH_OCTAVES, inputs["Meter"])
    patches = builder.math("ADD", patches, builder.math("MULTIPLY", detail.fine, 0.5))
    ground = builder.mix(ramp(builder, patches, 0.08, 0.12), inputs["Grass"], inputs["Dry Grass"])
    ground = builder.mix(ramp(builder, uneven, -0.06, 0.2), inputs["Undergrowth"], ground)
    is_sand = builder.math("SUBTRACT", 1.0, ramp(builder, height, inputs["Sand Height"], height_blend))
    ground = builder.mix(is_sand, ground, inputs["Sand"])
    is_snow = ramp(builder, height, inputs["Snow Height"], height_blend)
    ground = builder.mix(is_snow, ground, inputs["Snow"])

    start_of_scree = builder.math("ADD", inputs["Rock Slope"], inputs["Scree Width"])
    reach = builder.math("SUBTRACT", normal_z, builder.math("MULTIPLY", detail.stone_height, STONE_RISE))
    is_scree = builder.math("SUBTRACT", 1.0, ramp(builder, reach, start_of_scree, inputs["Slope Blend"]))
    is_scree = builder.math("MULTIPLY", is_scree, builder.math("SUBTRACT", 1.0, is_snow))
    is_rock = builder.math("SUBTRACT", 1.0, ramp(builder, normal_z, inputs["Rock Slope"], inputs["Slope Blend"]))
    # Loose stones lie in clumps, where the ground is uneven.
    loose = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", inputs["Stones"], ramp(builder, uneven, 0.1, 0.25)))
    is_loose = builder.math("GREATER_THAN", detail.stone_random, loose)
    is_loose = builder.math("MULTIPLY", is_loose, builder.math("MULTIPLY", detail.stone_height, 8.0, True))
    is_loose = builder.math("MULTIPLY", is_loose, builder.math("SUBTRACT", 1.0, is_snow))
    is_stone = builder.math("MULTIPLY", builder.math("MAXIMUM", is_scree, is_loose), builder.math("SUBTRACT", 1.0, is_rock))
    shade = between(builder, builder.math("MULTIPLY", detail.stone_height, 2.0, True), STONE_SHADE)
    shade = builder.math("MULTIPLY", shade, between(builder, detail.stone_random, *STONE_SHADES))
    ground = builder.mix(is_stone, ground, builder.vector("SCALE", inputs["Scree"], shade))

    streaks = builder.vector("MULTIPLY", inputs["Position"], (1.0, 1.0, STREAK_ASPECT))
    streaks = builder.math("MULTIPLY", detail.noise(STREAK_WAVELENGTH, 3, inputs["Meter"], streaks, part=detail.is_steep), STREAK_COLOR)
    rock = builder.mix(ramp(builder, detail.strata, 0.0, 0.1), inputs["Rock"], inputs["Strata"])
    rock = builder.vector("SCALE", rock, builder.math("MULTIPLY", builder.math("ADD", streaks, 1.0), detail.rock_shade))
    color = builder.mix(is_rock, ground, rock)

    is_smooth = builder.math("MULTIPLY", builder.math("MAXIMUM", is_sand, is_snow), builder.math("SUBTRACT", 1.0, is_rock))
    is_even = builder.math("ADD", is_smooth, builder.math("MULTIPLY", is_rock, ROCK_EVENNESS))
    contrast = between(builder, is_even, 1.0, SMOOTH_CONTRAST)
    noise_factor = builder.math("ADD", builder.math("MULTIPLY", noise, inputs["Color Noise"]), 1.0)
    lee = builder.math("MULTIPLY", ramp(builder, normal_x, 0.1, 0.25), 1.0 - LEE_RIPPLES)
    has_ripples = builder.math("MULTIPLY", builder.math("SUBTRACT", 1.0, lee), ramp(builder, plain_z, RIPPLE_STEEPNESS + 0.05, 0.05))
    has_ripples = builder.math("MULTIPLY", has_ripples, between(builder, ramp(builder, patches, 0.0, 0.2), CALM_RIPPLES))
    has_ripples = builder.math("MULTIPLY", has_ripples, builder.math("MULTIPLY", is_sand, builder.math("SUBTRACT", 1.0, is_stone)))
    brightness = builder.math("ADD", builder.math("MULTIPLY", detail.shade, contrast), 1.0)
    brightness = builder.math("ADD", builder.math("MULTIPLY", detail.ripple_shade, has_ripples), brightness)
    color = builder.vector("SCALE", color, builder.math("MULTIPLY", noise_factor, brightness))
    return Layers(color, is_rock, is_stone, has_ripples)
